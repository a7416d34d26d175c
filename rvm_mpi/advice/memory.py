"""The memory that a job takes, and whether this machine has it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from math import ceil, prod
from typing import TYPE_CHECKING

from rvm_mpi.advice.initial import ROWS_AT_ONCE
from rvm_mpi.collisions.weights import Rows
from rvm_mpi.grid.domain import partition
from rvm_mpi.job.text import JobError

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

LIBRARIES = 239e6
"""Bytes a process holds beside its arrays: Python, numba and kernels, PETSc, MPI, HDF5 (benchmarks/memory.py)."""
MAKING_WEIGHTS = 8
"""Memory that making the Boltzmann operator's weights takes for a moment, over that of the weights."""
GHOSTS_OF_G = 2
GHOSTS_OF_FLUID = 3
LANES = 8


@dataclass(frozen=True)
class Memory:
    """Bytes of one rank, the largest one, and what the ranks of a node have in common."""

    g: float
    """Two ghosted copies of g."""
    fluxes: float
    """A row of fluxes and the blocks in hand."""
    operator: float
    """The Boltzmann operator: its buffers and the rate of g, without the weights."""
    weights: float
    """The Boltzmann operator's weights: once a node, whatever the number of ranks on it."""
    fields: float
    """Macroscopic fields: moments, omega, the fluid system's stages, what is written; the start of all cells."""
    libraries: float

    @property
    def total(self) -> float:
        """All that is this rank's own."""
        return self.g + self.fluxes + self.operator + self.fields + self.libraries


def memory(job: Job, ranks: int = 1) -> Memory:
    """Memory of the rank that owns the most cells.

    Raises
    ------
    JobError
        If so many ranks cannot share the cells.
    """
    n_x, n_y = largest_share(job, ranks)
    block = cell_block(job.velocity.points)

    def ghosted(width: int) -> int:
        wx = width if job.space.dimensions >= 1 else 0
        wy = width if job.space.dimensions == 2 else 0
        return (n_x + 2 * wx) * (n_y + 2 * wy)

    operator, weights = 0.0, 0.0
    if job.collision.explicit:
        rows = Rows.create(tuple(job.velocity.points))
        operator, weights = 8.0 * (n_x * n_y + 60) * block + rows.nbytes, float(rows.weight_bytes)
    return Memory(
        operator=operator,
        weights=weights,
        g=2 * 8.0 * ghosted(GHOSTS_OF_G) * block,
        fluxes=8.0 * (n_x + 7) * block,
        fields=_fields_of_cells(job, n_x * n_y, ghosted(GHOSTS_OF_FLUID)),
        libraries=LIBRARIES,
    )


def _fields_of_cells(job: Job, own: int, ghosted: int) -> float:
    """Bytes of all that has one number or a few in each cell, on a rank with so many cells, ghosts without and with."""
    d, everywhere = job.velocity.dimensions, prod(job.space.cells)
    state = 1 + d + d * d  # density, velocity, temperature tensor
    levels, diagnostics, rates = 3 * 16, 2 * 10, 5
    snapshot = 2 + 2 * d + 2 * d * d
    fluid = 5 * (d + 2) * ghosted + (d + 2) * own if job.fluid.enabled else 0
    # the progress line on rank 0 looks at the initial state of the whole grid
    looked_at = 3 * (1 + d) * everywhere + state * min(everywhere, ROWS_AT_ONCE)
    return 8.0 * ((levels + diagnostics + rates + snapshot + state) * own + fluid + looked_at)


def largest_share(job: Job, ranks: int) -> tuple[int, int]:
    """Cells along x and y of the rank that owns the most; `JobError` if so many ranks cannot share them."""
    split = partition(job.space.cells, ranks)
    nx, ny = (*job.space.cells, 1, 1)[:2]
    return ceil(nx / split[0]), ceil(ny / split[1])


def check_weights(job: Job, available: float | None = None) -> None:
    """Refuse a Boltzmann operator whose weights do not fit into this machine's memory.

    Raises
    ------
    JobError
        With their size and the largest grid of the same shape that would fit.
    """
    if not job.collision.explicit:
        return
    if available is None:
        available = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    points = tuple(job.velocity.points)

    def needed(points: tuple[int, ...]) -> float:
        return float(MAKING_WEIGHTS * Rows.create(points).weight_bytes)

    if needed(points) <= available:
        return
    fitting = points
    while needed(fitting) > available:
        fitting = tuple(max(4, int(0.9 * n) // 2 * 2) for n in fitting)
    raise JobError(
        f"velocity.points: the Boltzmann operator's weights do not fit (value {list(points)}: "
        f"{bytes_in_words(Rows.create(points).weight_bytes)} and {MAKING_WEIGHTS} times that while they are made, of "
        f"{bytes_in_words(available)}; allowed such as {list(fitting)})"
    )


def cell_block(points: tuple[int, ...]) -> int:
    """Doubles that hold the velocities of one cell: each slab of (y, z) padded to whole vectors."""
    slab = prod(points[1:])
    return points[0] * ceil(slab / LANES) * LANES


def bytes_in_words(size: float) -> str:
    """A size: "12 MB", "3.4 GB"."""
    for unit, length in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if size >= length:
            return f"{size / length:.3g} {unit}"
    return f"{size / 1e3:.3g} kB"
