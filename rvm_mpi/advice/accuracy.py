"""What the Boltzmann operator's viscosity and heat conduction are worth on a velocity grid, and the grid that cures it.

From a measured table (`accuracy_tables.py`) by points and half width in units of sqrt(T_g).

The operator's figures are linear about a Maxwellian. In a box so narrow that the gas itself leaves the Maxwellian a
gradient conducts more still (d = 2, half width 5.5: 1.18 and not 1.07; from 6.5 on there is no difference to speak of).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import inf, isfinite, sqrt
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.advice.accuracy_tables import BOLTZMANN, HALF_WIDTHS
from rvm_mpi.advice.initial import start_fields
from rvm_mpi.collisions.weights import SUPPORT
from rvm_mpi.job.text import JobError

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

WARNED = 0.02
"""Error of viscosity, heat conduction or loss of energy from which a job is warned."""
CURED = 0.1
"""Error up to which another half width with the same points is spoken of as a cure."""
REFUSED = 0.25
"""Error from which a job with the Boltzmann operator is refused without `collision.coarse`."""
LASTED = 10.0
"""Relaxation times in which the tables' fluxes build up: a residue r adds LASTED r to them."""
PERIOD = 4
"""Grids behave alike whose points differ by so many: the sign of what the Nyquist mode keeps goes with points/2."""
MOST_POINTS = 64
"""Points an axis up to which a cure is looked for."""
AGAIN = 10.0
"""Growth of the error after which a run speaks of it again."""

Temperatures = tuple[float, float]


@dataclass(frozen=True)
class Worth:
    """Viscosity (d = 1: loss of energy) and heat conduction over the exact ones, and the share of a heat flux that
    never relaxes; infinite off the tables.
    """

    first: float
    conductivity: float
    residue: float

    def error(self, heat: bool) -> float:
        """The largest relative error; without heat that of viscosity or loss of energy alone."""
        found = abs(self.first - 1.0)
        return max(found, abs(self.conductivity - 1.0), LASTED * abs(self.residue)) if heat else found


OFF = Worth(inf, inf, inf)


def operator_worth(points: Iterable[int], half_width: float, temperature: float) -> Worth:
    """What the elastic Boltzmann operator's figures are worth in a gas of this temperature: those of the worst axis.

    Parameters
    ----------
    points : iterable of int
        In each direction of velocity.
    half_width, temperature : float
        V and T_g.
    """
    points = tuple(points)
    found = [_looked_up(len(points), n, half_width / sqrt(temperature)) for n in sorted(set(points))]
    return max(found, key=lambda worth: worth.error(True))


def _looked_up(d: int, points: int, half_width: float) -> Worth:
    widths, table = HALF_WIDTHS[d], BOLTZMANN[d]
    if half_width < widths[0]:
        return OFF
    # beyond the widest box the spacing alone counts: as many points as have it there
    wanted = points * min(1.0, widths[-1] / half_width)
    known = [n for n in table if (n - points) % PERIOD == 0]
    below, above = [n for n in known if n <= wanted + 1e-9], [n for n in known if n > wanted + 1e-9]
    if not below:
        return OFF
    figures = [float(np.interp(half_width, widths, row)) for row in table[max(below)]]
    if above and max(below) < wanted - 1e-9:
        finer = [float(np.interp(half_width, widths, row)) for row in table[min(above)]]
        share = (wanted - max(below)) / (min(above) - max(below))
        exact = (1.0, 1.0, 0.0)
        figures = [c + _between(a - c, b - c, share) for a, b, c in zip(figures, finer, exact)]
    return Worth(*figures, *[0.0] * (3 - len(figures)))


def _between(a: float, b: float, share: float) -> float:
    """An error between two: they fall by factors, not by differences, where they have one sign."""
    return a * (b / a) ** share if a * b > 0.0 else a + share * (b - a)


def _operator_counts(job: Job) -> bool:
    """Elastic collisions in one dimension exchange velocities: they do nothing."""
    return job.collision.explicit and not (job.velocity.dimensions == 1 and job.collision.elastic)


def grid_temperatures(job: Job) -> Temperatures:
    """Smallest and largest T_g at the start; in classical variables those of the sides count too."""
    start = start_fields(job)
    on_grid = start.temperature / start.omega**2
    found = [float(on_grid.min()), float(on_grid.max())]
    if job.scaling.kind == "none":
        found += [side.temperature for side in job.space.sides.values() if side.temperature is not None]
    return min(found), max(found)


def _worst(worth: Callable[[float], Worth], temperatures: Temperatures, heat: bool) -> tuple[Worth, float]:
    """The worse of the coldest and the hottest gas, and its temperature."""
    found = [(worth(temperature), temperature) for temperature in temperatures]
    return max(found, key=lambda one: one[0].error(heat))


def _job_worth(job: Job, temperatures: Temperatures) -> tuple[Worth, float]:
    velocity = job.velocity
    return _worst(
        lambda temperature: operator_worth(velocity.points, velocity.half_width[0], temperature),
        temperatures,
        job.space.dimensions > 0,
    )


def _figures(worth: Worth, job: Job, temperature: float = 1.0) -> str:
    """Such as "viscosity 1.01, heat conduction 0.98 of the exact ones, 1.2 % of a heat flux never relaxes"."""
    at = "" if abs(temperature - 1.0) < 5e-3 else f" at {_t_g(job)} = {temperature:.3g}"
    first = "loss of energy" if job.velocity.dimensions == 1 else "viscosity"
    if not isfinite(worth.first):
        return f"{first} and heat conduction are off by more than was ever measured{at}"
    text = f"{first} {number(worth.first)}, heat conduction {number(worth.conductivity)} of the exact ones{at}"
    if job.velocity.dimensions > 1:
        share = f"{100 * abs(worth.residue):.2g} %" if abs(worth.residue) < 0.995 else "all"
        text += f", {share} of a heat flux never relaxes"
    return text


def number(worth: float) -> str:
    """A figure over the exact one, to three digits behind the point."""
    return f"{worth:.3f}" if abs(worth) < 9.9995 else f"{worth:.3g}"


def _t_g(job: Job) -> str:
    return "T" if job.scaling.kind == "none" else "T_g"


def _cure(job: Job, temperatures: Temperatures) -> str:
    """The fewest points with this half width, the best half width with these points, or both, with their figures."""
    velocity, heat = job.velocity, job.space.dimensions > 0
    d, present = velocity.dimensions, velocity.half_width[0]
    unit = sqrt(temperatures[1])
    steps = range(4 * int(HALF_WIDTHS[d][0]), 4 * int(HALF_WIDTHS[d][-1]) + 1)
    widths = [float(f"{step / 4 * unit:.3g}") for step in steps]

    def worst(points: Iterable[int], width: float) -> Worth:
        return _worst(lambda temperature: operator_worth(points, width, temperature), temperatures, heat)[0]

    def error(points: Iterable[int], width: float) -> float:
        return worst(points, width).error(heat)

    cures = []
    best = min(widths, key=lambda width: error(velocity.points, width))
    least = min(velocity.points)
    more = next((n for n in range(least + 1, MOST_POINTS + 1) if error((n,) * d, present) <= WARNED), None)
    if more is not None:
        cures.append(f"{more} points a direction ({_short(worst((more,) * d, present), job)})")
    if error(velocity.points, best) < min(0.8 * error(velocity.points, present), CURED):
        cures.append(f"half_width {best:.3g} with these ({_short(worst(velocity.points, best), job)})")
    if more is None and error(velocity.points, best) > WARNED:
        grids = ((n, min(widths, key=lambda width: error((n,) * d, width))) for n in range(8, MOST_POINTS + 1))
        found = next(((n, width) for n, width in grids if error((n,) * d, width) <= WARNED), None)
        if found is not None:
            n, width = found
            cures.append(f"{n} points a direction with half_width {width:.3g} ({_short(worst((n,) * d, width), job)})")
    if not cures:
        return "temperatures lie too far apart for one velocity grid: take a scaling.kind other than none"
    return f"take {' or '.join(cures)}"


def _short(worth: Worth, job: Job) -> str:
    if job.space.dimensions == 0:
        return f"{'loss of energy' if job.velocity.dimensions == 1 else 'viscosity'} {number(worth.first)}"
    return f"heat conduction {number(worth.conductivity)}"


def check_grid(job: Job) -> None:
    """Refuse a velocity grid on which the Boltzmann operator is far from itself, unless `collision.coarse` is true.

    Raises
    ------
    JobError
        Naming the key, what the grid's viscosity and heat conduction are worth, and a grid that would do.
    """
    if not _operator_counts(job) or job.collision.coarse:
        return
    temperatures = grid_temperatures(job)
    worth, temperature = _job_worth(job, temperatures)
    if worth.error(job.space.dimensions > 0) <= REFUSED:
        return
    width = job.velocity.half_width[0]
    points = list(job.velocity.points)
    key = f"velocity.points: too few for the Boltzmann operator (value {points}, half_width {width:g})"
    if _too_narrow(job, temperatures):
        key = f"velocity.half_width: too narrow for the Boltzmann operator (value {width:g}, points {points})"
    raise JobError(
        f"{key}: {_figures(worth, job, temperature)}; {_cure(job, temperatures)}, or ask for it with "
        "collision.coarse = true"
    )


def _too_narrow(job: Job, temperatures: Temperatures) -> bool:
    """Whether many more points would not help: it is the support that cuts the gas."""
    d = job.velocity.dimensions
    worth = operator_worth((MOST_POINTS,) * d, job.velocity.half_width[0], temperatures[1])
    return worth.error(job.space.dimensions > 0) > REFUSED


def operator_warning(job: Job, temperatures: Temperatures | None = None) -> str:
    """What is wrong with the Boltzmann operator on this grid, and its cure; empty where nothing is.

    temperatures: smallest and largest T_g, those of the start by default.
    """
    if not _operator_counts(job):
        return ""
    temperatures = temperatures or grid_temperatures(job)
    worth, temperature = _job_worth(job, temperatures)
    if worth.error(job.space.dimensions > 0) <= WARNED:
        return ""
    figures = _figures(worth, job, temperature)
    return f"the Boltzmann operator on this velocity grid: {figures}; {_cure(job, temperatures)}"


class GridWatch:
    """Says during a run when the gas has become too cold or too hot for the Boltzmann operator on the job's grid.

    Once when an error passes `WARNED`, and again each time it has grown by ten; what was said at the start is not said
    again.

    Parameters
    ----------
    job : Job
    """

    def __init__(self, job: Job) -> None:
        self._job, self._next = job, WARNED
        self._counts = _operator_counts(job)

    def warnings(self, temperatures: Temperatures, row: Mapping[str, float]) -> list[str]:
        """Lines on the present smallest and largest T_g; `row` of the history says when.

        One point, read from the table, a step: what it costs does not show.
        """
        if not self._counts or not 0.0 < temperatures[0] <= temperatures[1] < inf:
            return []
        size = _job_worth(self._job, temperatures)[0].error(self._job.space.dimensions > 0)
        if size <= self._next:
            return []
        self._next = AGAIN * size
        return [f"{operator_warning(self._job, temperatures)} in step {row['step']:.0f} at t = {row['time']:.6g}"]


def describe(job: Job) -> Iterator[tuple[str, str]]:
    """Names and texts of the lines of `rvm check` on the operator, for jobs that have it."""
    if not _operator_counts(job):
        return
    temperatures = grid_temperatures(job)
    worth, temperature = _job_worth(job, temperatures)
    yield "Boltzmann operator", _figures(worth, job, temperature)
    unit, width = sqrt(temperature), job.velocity.half_width[0]
    yield (
        "  on this grid",
        f"spacing {2 * width / min(job.velocity.points) / unit:.3g}, support {SUPPORT * width / unit:.3g}, "
        f"in units of sqrt({_t_g(job)})",
    )
    if worth.error(job.space.dimensions > 0) > WARNED:
        yield "  warning", _cure(job, temperatures)
