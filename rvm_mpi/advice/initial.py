"""The initial state of all cells, as far as advice looks at it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.states import macroscopic_state
from rvm_mpi.step import fit

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

ROWS_AT_ONCE = 2**18
"""Cells whose initial state is looked at together, so that large grids need little memory here."""


@dataclass(frozen=True)
class StartFields:
    """The initial state on the whole grid, in arrays (ny, nx) and, per velocity direction, (ny, nx, d)."""

    density: np.ndarray
    temperature: np.ndarray
    velocity: np.ndarray
    thermal: np.ndarray
    """Square root of the diagonal of the temperature tensor."""
    omega: np.ndarray


def start_fields(job: Job) -> StartFields:
    """The initial density, temperature, velocity and omega of every cell."""
    parts = []
    for _, density, velocity, tensor in initial_rows(job):
        variance = np.diagonal(tensor, axis1=-2, axis2=-1).copy()
        parts.append((density, velocity, variance, fit.scaled(job, velocity, tensor).omega))
    density, velocity, variance, omega = (np.concatenate(part) for part in zip(*parts, strict=True))
    return StartFields(density, variance.mean(-1), velocity, np.sqrt(variance), omega)


def initial_rows(job: Job) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """The initial state by blocks of rows: the first row, density, velocity and temperature tensor."""
    nx, ny = (*job.space.cells, 1, 1)[:2]
    rows = max(1, ROWS_AT_ONCE // nx)
    for j in range(0, ny, rows):
        yield (j, *macroscopic_state(job, 0, nx, j, min(ny, j + rows)))


def mean_state(start: StartFields) -> tuple[float, float]:
    """Mean density, and mean temperature by mass."""
    mass = start.density / start.density.mean()
    return float(start.density.mean()), float((mass * start.temperature).mean())
