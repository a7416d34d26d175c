"""What viscosity and heat conduction are worth on a job's velocity grid, in words, and the grid that cures it.

From measured tables (`accuracy_tables.py`): the Boltzmann operator by points and half width, and the drift of rescaled
velocities by spacing, both in units of sqrt(T_g). The heat flux of ES-BGK in classical variables is a fourth moment of
its discrete Gaussians, taken here.

The operator's figures are linear about a Maxwellian. In a box so narrow that the gas itself leaves the Maxwellian a
gradient conducts more still (d = 2, half width 5.5: 1.18 and not 1.07; from 6.5 on there is no difference to speak of).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import ceil, exp, inf, isfinite, log, sqrt
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.advice.accuracy_tables import BOLTZMANN, DRIFT, HALF_WIDTHS, SPACINGS
from rvm_mpi.advice.estimates import start_fields
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


# --- the Boltzmann operator


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
    return job.collision.operator == "boltzmann" and not (job.velocity.dimensions == 1 and job.collision.elastic)


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
    text = f"{first} {_number(worth.first)}, heat conduction {_number(worth.conductivity)} of the exact ones{at}"
    if job.velocity.dimensions > 1:
        share = f"{100 * abs(worth.residue):.2g} %" if abs(worth.residue) < 0.995 else "all"
        text += f", {share} of a heat flux never relaxes"
    return text


def _number(worth: float) -> str:
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
        return f"{'loss of energy' if job.velocity.dimensions == 1 else 'viscosity'} {_number(worth.first)}"
    return f"heat conduction {_number(worth.conductivity)}"


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


# --- the drift in rescaled velocities, and Gaussians in classical ones


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
    along, across = DRIFT[drift]
    spacing = [h / sqrt(temperature) for h in spacing]
    lost = [_drift_error(along if q == axis else across, h) for q, h in enumerate(spacing)]
    return [(3.0 if q == axis else 1.0) / (len(lost) + 2) * error for q, error in enumerate(lost)]


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
    from scipy.optimize import brentq  # late: a job that is refused need not wait for it

    h = 2 * half_width / points
    square = ((np.arange(points) + 0.5) * h - half_width) ** 2
    square_least = float(square.min())

    def moment(log_width: float, power: int) -> float:
        weights = np.exp(-0.5 * (square - square_least) * exp(-2 * log_width))
        return float(weights @ square**power / weights.sum())

    def fourth(wanted: float) -> float:
        """The fourth moment of the discrete Gaussian with this variance; inf where the grid holds none."""
        narrow, wide = log(h / 10), log(100 * half_width)
        if not moment(narrow, 1) < wanted < moment(wide, 1):
            return inf
        return moment(brentq(lambda width: moment(width, 1) - wanted, narrow, wide, xtol=1e-13), 2)

    step = 1e-3 * temperature
    above, below = (fourth(t) / t for t in (temperature + step, temperature - step))
    worth = ((above - below) / (2 * step) + dimensions - 1) / (dimensions + 2)
    return worth if isfinite(worth) else inf


@dataclass(frozen=True)
class Conduction:
    """Heat conduction over the exact one, and the sum of the sizes of its errors, which may cancel."""

    worth: float
    size: float


def conduction(job: Job, points: Iterable[int], drift: str, temperatures: Temperatures) -> Conduction:
    """That along the worst direction of space, with these points and this drift; for jobs with space."""
    velocity, points = job.velocity, tuple(points)
    found = []
    for axis in range(job.space.dimensions):
        for temperature in set(temperatures):
            if job.scaling.kind == "none":
                worth = gaussian_worth(points[axis], velocity.half_width[axis], temperature, velocity.dimensions)
                found.append(Conduction(worth, abs(worth - 1.0)))
                continue
            spacing = [2 * width / n for width, n in zip(velocity.half_width, points, strict=True)]
            errors = drift_errors(drift, spacing, temperature, axis)
            found.append(Conduction(1.0 + sum(errors), sum(map(abs, errors))))
    return max(found, key=lambda one: one.size)


def _conduction_cure(job: Job, temperatures: Temperatures) -> str:
    """Another drift on this grid, or the same on more points, with what the conduction then is."""
    points, present, others = job.velocity.points, job.scheme.drift, []
    if job.scaling.kind != "none":
        others = [drift for drift in DRIFT if drift != present]
    tried = [(drift, conduction(job, points, drift, temperatures)) for drift in others]
    cures = []
    if tried:
        best, found = min(tried, key=lambda one: one[1].size)
        if found.size <= WARNED:
            cures.append(f'scheme.drift = "{best}" ({found.worth:.3f})')
    for eighths in range(9, 41):
        more = [ceil(n * eighths / 8) for n in points]
        found = conduction(job, more, present, temperatures)
        if found.size <= WARNED:
            cures.append(f"velocity.points = {more} ({found.worth:.3f})")
            break
    return f"take {' or '.join(cures)}" if cures else "take more velocity.points, or another scheme.drift with them"


# --- what `rvm check` prints


def describe(job: Job) -> Iterator[tuple[str, str]]:
    """Names and texts of the lines of `rvm check` on what this velocity grid is worth."""
    temperatures = grid_temperatures(job)
    if _operator_counts(job):
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
    operator, classical = job.collision.operator, job.scaling.kind == "none"
    made = operator != "none" and (job.scheme.drift in DRIFT if not classical else operator != "boltzmann")
    if job.space.dimensions > 0 and made:
        yield from _describe_conduction(job, temperatures)


def _describe_conduction(job: Job, temperatures: Temperatures) -> Iterator[tuple[str, str]]:
    """Of the drift, or of the Gaussians where there is none; the viscosity is right to 0.3 % on all grids measured."""
    made = "discrete Gaussians" if job.scaling.kind == "none" else f"the drift {job.scheme.drift}"
    found = conduction(job, job.velocity.points, job.scheme.drift, temperatures)
    if isfinite(found.size):
        text = f"{_number(found.worth)} of the exact one by {made} on this velocity grid"
        if found.size > 2 * abs(found.worth - 1.0) and found.size > WARNED:
            text += f", where errors of {100 * found.size:.0f} % in all cancel each other"
        if job.velocity.dimensions > 1:
            text += "; viscosity 1.00"
        yield "heat conduction", text
    else:
        yield "heat conduction", f"off by more than was ever measured by {made} on this velocity grid"
    if found.size > WARNED:
        yield "  warning", _conduction_cure(job, temperatures)
