"""Whether the velocity grid holds the initial state and what the sides send in, and how cold a gas it can hold."""

from __future__ import annotations

from decimal import ROUND_CEILING, Decimal
from math import ceil, inf, sqrt
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.advice.initial import initial_rows, start_fields
from rvm_mpi.job.text import JobError
from rvm_mpi.step import fit

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

STANDARD_DEVIATIONS = 3.0
"""A box must hold the state this many thermal speeds around its mean velocity: one in 400 lies outside."""


def least_temperature(points: int, half_width: float, mean: float = 0.0) -> float:
    """The smallest variance that numbers on the nodes of one direction can have about a mean.

    With all weight on the two nodes around the mean it is their distances' product: at rest (h/2)^2 for an
    even number of points, 0 for an odd one. Infinite outside the box.
    """
    h = 2 * half_width / points
    position = (mean + half_width) / h - 0.5
    if not 0 <= position <= points - 1:
        return inf
    below = position - np.floor(position)
    return float(h**2 * below * (1 - below))


def sampled_temperature(points: int, half_width: float, temperature: float) -> float:
    """Variance of a Gaussian at rest as sampled on the nodes of one direction, without any correction."""
    h = 2 * half_width / points
    nodes = (2 * np.arange(points) + 1 - points) * (0.5 * h)
    weights = np.exp(-0.5 * (nodes**2 - (nodes**2).min()) / temperature)
    return float((weights * nodes**2).sum() / weights.sum())


def sampling_limit(points: int, half_width: float, error: float = 0.01) -> float:
    """Temperature below which a sampled Gaussian's variance is wrong by more than `error`; inf if all are."""
    h = 2 * half_width / points
    trials = np.geomspace((half_width / 4) ** 2, (h / 10) ** 2, 400)
    limit = inf
    for trial in trials:
        if abs(sampled_temperature(points, half_width, trial) / trial - 1) > error:
            return limit
        limit = float(trial)
    return limit


def smallest_temperature(job: Job) -> float:
    """Smallest temperature at rest that the velocity grid can hold: of g, of f where nothing is rescaled."""
    velocity = job.velocity
    axes = zip(velocity.points, velocity.half_width, strict=True)
    return sum(least_temperature(points, width) for points, width in axes) / velocity.dimensions


def largest_mach(job: Job) -> float:
    """The Mach number at which omega^2 = T + |u|^2/d makes T_g the smallest the grid can hold."""
    d, smallest = job.velocity.dimensions, smallest_temperature(job)
    if smallest >= 1:
        return 0.0
    if smallest == 0:
        return inf
    return sqrt(d * (1 / smallest - 1) * d / (d + 2))


def check_box(job: Job) -> None:
    """Refuse a velocity grid too small or too coarse for the initial state or for a side's.

    Raises
    ------
    JobError
        Naming the direction and the half width or the number of points that would do.
    """
    start = start_fields(job)
    scale = start.omega[..., None]
    mean = np.zeros_like(start.velocity) if job.scaling.kind == "thermal" else start.velocity / scale
    _check_width(job, "the initial state", mean, start.thermal / scale)
    for j, density, velocity, tensor in initial_rows(job):
        problem = fit.misfit(job, density, velocity, tensor, (0, j))
        if problem:
            raise JobError(problem)
    check_sides(job)


def check_sides(job: Job) -> None:
    """Refuse a wall or a far field whose given state the velocity grid cannot hold.

    Raises
    ------
    JobError
        Naming the side, its temperature and Mach number, and the points that would do.
    """
    for name, side in job.space.sides.items():
        if side.temperature is not None and side.velocity is not None:
            _check_side(job, name, np.array(side.velocity), side.temperature)


def _check_side(job: Job, name: str, velocity: np.ndarray, temperature: float) -> None:
    """Refuse a wall's or a far field's state that the velocity grid cannot hold in its own omega (unscaled: as it is).

    In gas of another temperature it enters with its own moments all the same (`kinetic/walls.py`).
    """
    d = job.velocity.dimensions
    if job.scaling.kind == "thermal":
        velocity = np.zeros(d)  # it is counted from the gas's own
    omega = 1.0 if job.scaling.kind == "none" else sqrt(temperature + float(velocity @ velocity) / d)
    mean, variance = velocity / omega, temperature / omega**2
    _check_width(job, f"the gas from {name}", mean, np.full(d, sqrt(variance)))
    for axis, (points, width) in enumerate(zip(job.velocity.points, job.velocity.half_width, strict=True)):
        least = float(fit.least_variance(points, width, mean[axis]))
        if variance >= least:
            continue
        speed = sqrt(float(velocity @ velocity)) / sqrt((d + 2) / d * temperature)
        of = "T" if job.scaling.kind == "none" else "T/omega^2"
        needed = ceil(2 * width / sqrt(variance / (0.25 + fit.ROOM)))
        raise JobError(
            f"space.boundary.{name.replace('-', '.')}: the velocity grid cannot hold its state (temperature "
            f"{temperature:g}, Mach {speed:.3g}): along {'xyz'[axis]} {points} points hold no {of} below {least:.4g} "
            f"at its mean velocity, it has {variance:.4g}; allowed with {needed} points there, or slower and warmer"
        )


def unresolved_sides(job: Job) -> list[str]:
    """What to say of walls and far fields that are colder than the nodes across hold in the gas of the hottest one.

    Without collisions what such a side sends in runs through that gas with the temperature of the nodes, not its own.
    """
    if job.scaling.kind in ("none", "thermal") or job.velocity.dimensions == 1:
        return []
    given = {name: side.temperature for name, side in job.space.sides.items() if side.temperature is not None}
    hottest = max([float(start_fields(job).temperature.max()), *given.values()])
    lines = []
    for name, temperature in given.items():
        middle = sqrt(temperature * hottest)  # of two streams, one from this side and one from the hottest
        # what is too much of T/omega^2 in each direction across
        excess = {}
        for axis, (points, width) in enumerate(zip(job.velocity.points, job.velocity.half_width, strict=True)):
            lacking = float(fit.least_variance(points, width, np.zeros(()))) - temperature / middle
            if lacking > 0.0 and "xyz"[axis] != name[0]:
                excess["xyz"[axis]] = lacking
        if not excess:
            continue
        heat = (job.velocity.dimensions + 1) / 2 * (hottest - temperature) / middle
        needed = max(
            ceil(2 * job.velocity.half_width["xyz".index(axis)] / sqrt(temperature / middle / (0.25 + fit.ROOM)))
            for axis in excess
        )
        lines.append(
            f"{name} (T = {temperature:g}) beside gas at T = {hottest:g}: the nodes along {' and '.join(excess)} do "
            f"not hold its temperature there; without collisions about {50 * sum(excess.values()) / heat:.2g} % too "
            f"little heat; {needed} points, or a smaller half_width, would do"
        )
    return lines


def _check_width(job: Job, what: str, mean: np.ndarray, thermal: np.ndarray) -> None:
    reach = np.abs(mean) + STANDARD_DEVIATIONS * thermal
    needed = reach.reshape(-1, reach.shape[-1]).max(0)
    for axis, width in enumerate(job.velocity.half_width):
        if needed[axis] > width:
            raise JobError(
                f"velocity.half_width: too small for {what} (value {list(job.velocity.half_width)}; allowed "
                f"at least {_rounded_up(float(needed[axis]))} along {'xyz'[axis]}: {STANDARD_DEVIATIONS:g} "
                "thermal speeds around its mean velocity)"
            )


def _rounded_up(value: float) -> float:
    """Three digits, no less than the value."""
    exact = Decimal(value)
    return float(exact.quantize(Decimal(1).scaleb(exact.adjusted() - 2), rounding=ROUND_CEILING))
