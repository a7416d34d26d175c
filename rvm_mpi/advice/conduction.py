"""What the drift of rescaled velocities, or discrete Gaussians in classical ones, make of transport; its cure.

Of heat conduction and viscosity, that is.

From a measured table (`accuracy_tables.py`) by the spacing in units of sqrt(T_g); that of Gaussians is taken here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import ceil, exp, inf, isfinite, log, sqrt
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.advice.accuracy import WARNED, Temperatures, grid_temperatures, number
from rvm_mpi.advice.accuracy_tables import DRIFT, SPACINGS

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job


def drift_worth(drift: str, spacing: Iterable[float], temperature: float, axis: int = 0) -> float:
    """Heat conduction along an axis over the exact one, as the reconstruction of the drift makes it.

    Parameters
    ----------
    drift : str
        A key of `accuracy_tables.DRIFT`.
    spacing : iterable of float
        Of the velocities in each direction.
    temperature : float
        T_g.
    axis : int
        Direction of the gradient.
    """
    return 1.0 + sum(drift_errors(drift, spacing, temperature, axis))


def drift_errors(drift: str, spacing: Iterable[float], temperature: float, axis: int) -> list[float]:
    """What each direction of velocity adds to `drift_worth`."""
    along, across, _ = DRIFT[drift]
    spacing = [h / sqrt(temperature) for h in spacing]
    lost = [_drift_error(along if q == axis else across, h) for q, h in enumerate(spacing)]
    return [(3.0 if q == axis else 1.0) / (len(lost) + 2) * error for q, error in enumerate(lost)]


def drift_viscosity(drift: str, spacing: Iterable[float], temperature: float) -> float:
    """Viscosity over the exact one, by the direction that is worst; `drift` and the others as in `drift_worth`."""
    row = DRIFT[drift][2]
    return 1.0 + max((_drift_error(row, h / sqrt(temperature)) for h in spacing), key=abs)


def _drift_error(row: tuple[float, ...], spacing: float) -> float:
    """An error of the table; below its least spacing it falls with the square."""
    if spacing > SPACINGS[0] * (1 + 1e-6):
        return inf
    finest = SPACINGS[-1]
    return float(np.interp(spacing, SPACINGS[::-1], row[::-1]) - 1.0) * min(1.0, spacing / finest) ** 2


def gaussian_worth(points: int, half_width: float, temperature: float, dimensions: int) -> float:
    """Heat conduction along an axis over the exact one where ES-BGK relaxes to discrete Gaussians that stand still.

    The heat flux is minus d/dT of the Gaussians' sum of xi_x^2 |xi|^2 / T, (d + 2) T where all is exact.
    """
    step = 1e-3 * temperature
    above, below = (fourth_moment(points, half_width, t) / t for t in (temperature + step, temperature - step))
    worth = ((above - below) / (2 * step) + dimensions - 1) / (dimensions + 2)
    return worth if isfinite(worth) else inf


def fourth_moment(points: int, half_width: float, temperature: float) -> float:
    """Of the discrete Gaussian with this variance, at rest, along one direction; infinite where the grid holds none."""
    from scipy.optimize import brentq  # late: a job that is refused need not wait for it

    h = 2 * half_width / points
    square = ((np.arange(points) + 0.5) * h - half_width) ** 2
    square_least = float(square.min())

    def moment(log_width: float, power: int) -> float:
        weights = np.exp(-0.5 * (square - square_least) * exp(-2 * log_width))
        return float(weights @ square**power / weights.sum())

    narrow, wide = log(h / 10), log(100 * half_width)
    if not moment(narrow, 1) < temperature < moment(wide, 1):
        return inf
    return moment(brentq(lambda width: moment(width, 1) - temperature, narrow, wide, xtol=1e-13), 2)


@dataclass(frozen=True)
class Transport:
    """Heat conduction over the exact one, the sum of the sizes of its errors, which may cancel, and viscosity."""

    worth: float
    size: float
    viscosity: float = 1.0

    @property
    def error(self) -> float:
        """The larger of both errors, those of single directions counted by their sizes."""
        return max(self.size, abs(self.viscosity - 1.0))


def transport(job: Job, points: Iterable[int], drift: str, temperatures: Temperatures) -> Transport:
    """That along the worst direction of space, with these points and this drift; for jobs with space."""
    velocity, points = job.velocity, tuple(points)
    found = []
    for axis in range(job.space.dimensions):
        for temperature in set(temperatures):
            if job.scaling.kind == "none":
                worth = gaussian_worth(points[axis], velocity.half_width[axis], temperature, velocity.dimensions)
                found.append(Transport(worth, abs(worth - 1.0)))
                continue
            spacing = [2 * width / n for width, n in zip(velocity.half_width, points, strict=True)]
            errors = drift_errors(drift, spacing, temperature, axis)
            shear = drift_viscosity(drift, spacing, temperature) if velocity.dimensions > 1 else 1.0
            found.append(Transport(1.0 + sum(errors), sum(map(abs, errors)), shear))
    return max(found, key=lambda one: one.error)


def _transport_cure(job: Job, temperatures: Temperatures) -> str:
    """Another drift on this grid, or the same on more points, with what the conduction then is."""
    points, present, others = job.velocity.points, job.scheme.drift, []
    if job.scaling.kind != "none":
        others = [drift for drift in DRIFT if drift != present]
    cures = []
    for drift in others:  # the default first
        found = transport(job, points, drift, temperatures)
        if found.error <= WARNED:
            cures.append(f'scheme.drift = "{drift}" ({found.worth:.3f})')
            break
    for eighths in range(9, 41):
        more = [ceil(n * eighths / 8) for n in points]
        found = transport(job, more, present, temperatures)
        if found.error <= WARNED:
            cures.append(f"velocity.points = {more} ({found.worth:.3f})")
            break
    return f"take {' or '.join(cures)}" if cures else "take more velocity.points, or another scheme.drift with them"


def describe(job: Job) -> Iterator[tuple[str, str]]:
    """Names and texts of the lines of `rvm check`, for jobs with space."""
    facts, classical = job.collision.facts, job.scaling.kind == "none"
    made = facts.relaxes if classical else (facts.relaxes or facts.explicit) and job.scheme.drift in DRIFT
    if job.space.dimensions == 0 or not made:
        return
    temperatures = grid_temperatures(job)
    by = "discrete Gaussians" if job.scaling.kind == "none" else f"the drift {job.scheme.drift}"
    found = transport(job, job.velocity.points, job.scheme.drift, temperatures)
    if isfinite(found.size):
        text = f"{number(found.worth)} of the exact one by {by} on this velocity grid"
        if found.size > 2 * abs(found.worth - 1.0) and found.size > WARNED:
            text += f", where errors of {100 * found.size:.0f} % in all cancel each other"
        if job.velocity.dimensions > 1:
            text += f"; viscosity {number(found.viscosity)}"
        yield "heat conduction", text
    else:
        yield "heat conduction", f"off by more than was ever measured by {by} on this velocity grid"
    if found.error > WARNED:
        yield "  warning", _transport_cure(job, temperatures)
