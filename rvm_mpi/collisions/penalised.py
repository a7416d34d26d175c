"""An explicit operator in a step: its rate of g, the energy it takes, and the relaxation that it is penalised with."""

from __future__ import annotations

import math
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi import time_limits
from rvm_mpi.compiling.declare import kernel
from rvm_mpi.compiling.simd import LANES, fma, load, splat, total
from rvm_mpi.grid.velocity import Y, Z
from rvm_mpi.kinetic.gaussian import discrete_maxwellian
from rvm_mpi.kinetic.realisable import REPLACED
from rvm_mpi.units import power

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job


@kernel
def _penalise(g, space, grid, sums, rate, fit, gaussian, source):  # type: ignore[no-untyped-def]
    """source -= rate (G[g] - g) in every cell, G the discrete Maxwellian with the sums (ny, nx, 10) of g."""
    row = (space.nx + 2 * space.wx) * grid.block
    for j in range(space.ny):
        for i in range(space.nx):
            s = sums[j, i]
            speed2 = 0.0
            for q in range(3):
                gaussian.mean[q] = s[1 + q] / s[0]
                speed2 += gaussian.mean[q] ** 2
            temperature = ((s[4] + s[7] + s[9]) / s[0] - speed2) / grid.dimensions
            status = discrete_maxwellian(s[0], temperature, gaussian, grid, fit)
            cell = (j + space.wy) * row + (i + space.wx) * grid.block
            scale = s[0] / gaussian.sums[0] if status <= REPLACED else math.nan
            for n in range(grid.block):
                source[j, i, n] -= rate[j, i] * (scale * gaussian.block[n] - g[cell + n])


@kernel
def _heat(source, sums, grid, factor, heating):  # type: ignore[no-untyped-def]
    """heating (ny, nx) = factor (ny, nx) sum |xi - u|^2 source, u the mean of g with the sums (ny, nx, 10)."""
    n, slab_size, slab, nodes = 0, grid.slab_size, grid.slab, grid.x
    for j in range(heating.shape[0]):
        for i in range(heating.shape[1]):
            s = sums[j, i]
            ux, uy, uz = s[1] / s[0], s[2] / s[0], s[3] / s[0]
            square = splat(0.0)
            for x in range(nodes.size):
                along = (nodes[x] - ux) ** 2
                for m in range(0, slab_size, LANES):
                    cy, cz = load(slab, Y * slab_size + m) - uy, load(slab, Z * slab_size + m) - uz
                    square = fma(load(source, n), fma(cy, cy, fma(cz, cz, splat(along))), square)
                    n += LANES
            heating[j, i] = factor[j, i] * total(square)


class ExplicitOperator:
    """The rate of g by an operator that is taken explicitly, for the cells of a rank.

    The operator is made by `for_job` in the file of this room that has its name in a job file. With a penalisation the
    rate is that of the operator less a relaxation, which is put back implicitly.

    Parameters
    ----------
    job : Job
    comm : MPI communicator
        Whose ranks share the operator's weights.
    half_width : float
        V in the units that g is kept in.
    cells : tuple (ny, nx)
    block : int
        Doubles of a cell.

    Attributes
    ----------
    source : (ny, nx, block) array
        The rate of g.
    heating : (ny, nx) array
        The rate of f's energy that belongs to it: what is carried leaves out the momentum, whose rate is spectral error
        alone, and an elastic gas's energy.
    """

    def __init__(self, job: Job, comm: Any, half_width: float, cells: tuple[int, int], block: int) -> None:
        self.job = job
        self._operator = import_module(f"rvm_mpi.collisions.{job.collision.operator}").for_job(job, comm, half_width)
        self.source, self.heating = np.zeros((*cells, block)), np.zeros(cells)
        self._penalty, self._slowing = np.zeros(cells), np.ones(cells)

    def set_penalty(self, density: np.ndarray, temperature: np.ndarray, omega: np.ndarray, limits: Any) -> np.ndarray:
        """The rate (ny, nx) of the relaxation that is taken off the operator and put back, for the coming step.

        Half of the fastest rate of the operator, so that what is left grows in no mode; the mean rate at the least.
        Where it is above the largest, `limits`, operator and relaxation are slowed alike: it is the limit already.
        """
        mean = time_limits.collision_frequency(self.job, density, temperature)
        rate = np.maximum(mean, 0.5 * time_limits.fastest_rate(self.job, density, omega))
        self._penalty[...] = np.minimum(rate, limits)
        self._slowing[...] = self._penalty / rate
        return self._penalty

    def collide(self, stepper: Any, g: np.ndarray, cells: Any) -> None:
        """C[g] = omega^lambda Q(g, g)/eps, and the rate of f's energy, for g with ghosts and its cells."""
        collision, velocity_grid, grid = self.job.collision, stepper.velocity_grid, stepper.grid
        assert collision.knudsen is not None and collision.exponent is not None
        space = stepper.space
        inside = np.s_[space.wy : space.wy + space.ny, space.wx : space.wx + space.nx]
        omega = cells.omega[inside]
        # Q is quadratic in g: of the two units of density, one is that of the result
        scale = power(omega, collision.exponent) / collision.knudsen * stepper.units.density
        scale *= self._slowing
        values = velocity_grid.unpack(g[inside]).reshape(space.ny, space.nx, *self.job.velocity.points)
        source = velocity_grid.unpack(self.source).reshape(values.shape)  # both are views
        self._operator.collide(values, source, scale)
        if collision.penalise:
            work = stepper.work
            _penalise(
                g.reshape(-1), space, grid, cells.sums, self._penalty, work.fit, work.gaussian, self.source
            )
        if not collision.elastic:
            _heat(self.source.reshape(-1), cells.sums, grid, 0.5 * grid.weight * omega**2, self.heating)
