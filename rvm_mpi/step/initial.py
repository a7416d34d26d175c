"""g of the initial state: discrete Gaussians, and states that are sampled at the nodes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.compiling.declare import kernel
from rvm_mpi.grid.velocity import VelocityGrid
from rvm_mpi.kinetic.conservation import SUMS, correct
from rvm_mpi.kinetic.gaussian import discrete_gaussian
from rvm_mpi.kinetic.realisable import EXACT
from rvm_mpi.states import distribution
from rvm_mpi.step.data import Space, here, kernel_grid, lay_out, work_space
from rvm_mpi.units import GasUnits

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

THE_JOBS = GasUnits(1.0, 1.0, 1.0)


@kernel
def fill_gaussians(g, space, grid, sums, mean, tensors, status, buffer):  # type: ignore[no-untyped-def]
    """Discrete Gaussians with the given sums, means and tensors in every cell; status (ny, nx) of each."""
    work, _ = lay_out(grid, space.nx, buffer)
    gaussian = work.gaussian
    for j in range(space.ny):
        for i in range(space.nx):
            wanted = sums[j, i]
            status[j, i] = discrete_gaussian(
                wanted, mean[j, i], tensors[j, i], grid, work.fit, gaussian.block, gaussian.sums
            )
            at = here(grid, space, j, i).block
            scale = wanted / gaussian.sums[0]
            for n in range(grid.block):
                g[at + n] = scale * gaussian.block[n]


@kernel
def _correct(block, target, grid, work, sums):  # type: ignore[no-untyped-def]
    return correct(block, target, grid, work, sums)


def failing(job: Job, mean: np.ndarray, tensor: np.ndarray) -> np.ndarray:
    """Which of these states (n, 3), (n, 6) in g's velocities have no discrete Gaussian of exactly their moments."""
    grid = kernel_grid(VelocityGrid.create(job.velocity.points, job.velocity.half_width), job.scheme.drift)
    count = len(mean)
    status = np.zeros((1, count), dtype=np.int64)
    space = Space(1, count, 1, 0, 0, 1.0, 0.0)
    g, ones = np.zeros(count * grid.block), np.ones((1, count))
    fill_gaussians(g, space, grid, ones, mean[None].copy(), tensor[None].copy(), status, work_space(grid, count))
    return status[0] > EXACT


class Sampler:
    """g of a state that is no Gaussian: its values at the nodes, corrected to the moments given.

    Parameters
    ----------
    job : Job
        With such a state.
    units : GasUnits, optional
        What g is kept in; by default the job's units.
    """

    def __init__(self, job: Job, units: GasUnits = THE_JOBS) -> None:
        shape = distribution(job)
        assert shape is not None
        self._shape = shape
        half_width = tuple(v / units.velocity for v in job.velocity.half_width)
        self._velocity_grid = VelocityGrid.create(job.velocity.points, half_width, units.density)
        self._density = units.density
        self._grid = kernel_grid(self._velocity_grid, job.scheme.drift)
        self._work = lay_out.py_func(self._grid, 1, work_space(self._grid, 1))[0].correction

    def block(self, density: float, omega: float, mean: np.ndarray, tensor: np.ndarray) -> tuple[np.ndarray, float]:
        """(block,) values of g of one cell, and the relative size of what its moments were corrected by.

        density is that of f, mean (3,) and tensor (6,) those of xi; the size is negative where no correction exists.
        """
        grid, velocity_grid = self._grid, self._velocity_grid
        d, target, sums = grid.dimensions, np.zeros(5), np.zeros(SUMS)
        slab = (grid.points[0], grid.slab_size)
        axes = [omega * velocity_grid.nodes[q, : grid.points[q]] for q in range(d)]
        scale = math.prod([omega] * d) * (density / self._density)
        values = scale * self._shape(*np.meshgrid(*axes, indexing="ij"))
        block = np.zeros(slab)
        block[:, : velocity_grid.slab_points] = values.reshape(grid.points[0], -1)
        target[0] = density / grid.weight
        target[1:4] = target[0] * mean
        target[4] = 0.5 * target[0] * (np.sum(mean**2) + tensor[[0, 3, 5]].sum())
        off = _correct(block.reshape(-1), target, grid, self._work, sums)
        return (self._work.factor_x[:, None] * self._work.factor_slab * block).reshape(-1), float(off)
