"""g of the initial state: discrete Gaussians, and states that are sampled at the nodes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.collisions.es_bgk import EXACT, discrete_gaussian
from rvm_mpi.compiling.declare import kernel
from rvm_mpi.grid.velocity import VelocityGrid
from rvm_mpi.kinetic.conservation import SUMS, correct
from rvm_mpi.states import distribution
from rvm_mpi.step import sweep as stage
from rvm_mpi.units import GasUnits

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

THE_JOBS = GasUnits(1.0, 1.0, 1.0)


@kernel
def fill_gaussians(g, space, grid, density, mean, tensors, work, block, status, moments):  # type: ignore[no-untyped-def]
    """Discrete Gaussians with the given sums, means and tensors in every cell; status (ny, nx) of each."""
    row = (space.nx + 2 * space.wx) * grid.block
    for j in range(space.ny):
        for i in range(space.nx):
            status[j, i] = discrete_gaussian(density[j, i], mean[j, i], tensors[j, i], grid, work, block, moments)
            cell = (j + space.wy) * row + (i + space.wx) * grid.block
            scale = density[j, i] / moments[0]
            for n in range(grid.block):
                g[cell + n] = scale * block[n]


def failing(job: Job, mean: np.ndarray, tensor: np.ndarray) -> np.ndarray:
    """Which of these states (n, 3), (n, 6) in g's velocities have no discrete Gaussian of exactly their moments."""
    grid = stage.kernel_grid(VelocityGrid.create(job.velocity.points, job.velocity.half_width), job.scheme.drift)
    count = len(mean)
    work, status = stage.Work.create(grid, count), np.zeros((1, count), dtype=np.int64)
    fill_gaussians(
        np.zeros(count * grid.block),
        stage.Space(1, count, 1, 0, 0, 1.0, 0.0),
        grid,
        np.ones((1, count)),
        mean[None].copy(),
        tensor[None].copy(),
        work.fit,
        work.gaussian,
        status,
        np.zeros(10),
    )
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
        self._grid = stage.kernel_grid(self._velocity_grid, job.scheme.drift)
        self._work = stage.Work.create(self._grid, 1).correction

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
        off = correct(block.reshape(-1), target, d, *slab, grid.x, grid.slab, self._work, sums)
        return (self._work[0][:, None] * self._work[1][None, :] * block).reshape(-1), float(off)
