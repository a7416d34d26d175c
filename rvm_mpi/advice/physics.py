"""Scales of the gas at the start, and how they stand to the grid."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi import kinetic_theory
from rvm_mpi.advice.initial import mean_state, start_fields

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

COARSE = 0.1
"""Share of the gas in cells wider than its mean free path from which `rvm check` speaks of them."""


@dataclass(frozen=True)
class Range:
    """Smallest, mean and largest value over the cells; the mean is that of the gas, each cell by its mass."""

    low: float
    mean: float
    high: float

    @classmethod
    def of(cls, values: np.ndarray, mass: np.ndarray) -> Range:
        """The range of an array, its mean weighted with the cells' mass."""
        return cls(float(values.min()), float((values * (mass / mass.sum())).sum()), float(values.max()))


@dataclass(frozen=True)
class Physics:
    """Scales of the gas at the start, as `kinetic_theory` defines them.

    The mean state has the mean density and, by mass, the mean temperature: nearly empty cells do not count for more
    than they hold.
    """

    collision_time: Range
    mean_free_path: Range
    knudsen: float
    """Mean free path of the mean state over `length`; nan without space."""
    length: float
    """The domain's shortest side between two boundaries; where all directions are periodic, its shortest side."""
    cells_per_mean_free_path: float
    """Mean free path of the mean state over the widest cell's width; nan without space."""
    coarse: float
    """Share of the mass in cells that are wider than the mean free path in them; 0 without space."""
    shortest: float
    """Mean free path that a share `COARSE` of the gas has, or a shorter one."""
    haff_time: float
    """Time in which the mean state cools to a quarter; inf where it is elastic."""


def physics(job: Job) -> Physics | None:
    """Mean free path, collision time and their relation to the grid at the start; None without collisions."""
    collision, space, d = job.collision, job.space, job.velocity.dimensions
    if collision.operator == "none":
        return None
    start = start_fields(job)
    mass = start.density
    path = kinetic_theory.mean_free_path(collision, d, start.density, start.temperature)
    state = mean_state(start)
    mean_path = float(kinetic_theory.mean_free_path(collision, d, *map(np.asarray, state)))
    between = [length for axis, length in enumerate(space.length) if not space.periodic(axis)]
    length = min(between or space.length, default=nan)
    widest = max(space.spacing, default=nan)
    order = np.argsort(path, axis=None)
    share = np.cumsum(mass.ravel()[order]) / mass.sum()
    return Physics(
        collision_time=Range.of(path / kinetic_theory.mean_speed(d, start.temperature), mass),
        mean_free_path=Range.of(path, mass),
        knudsen=mean_path / length,
        length=length,
        cells_per_mean_free_path=mean_path / widest,
        coarse=float(mass[path < widest].sum() / mass.sum()),
        shortest=float(path.ravel()[order[np.searchsorted(share, COARSE)]]),
        haff_time=kinetic_theory.cooling_time(collision, *state),
    )
