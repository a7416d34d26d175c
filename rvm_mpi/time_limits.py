"""Every limit on the length of a time step, for a run and for `rvm check` alike.

A run measures the rates in its last stage, `rvm check` estimates them from the initial state; what a step may be
with them is written here, once. Rates of a cell, all in units of 1/time:

    transport   sum over the directions of space of omega V/h
    drift       sum over the directions of velocity of max|a|/h
    answering   the part of the drift that answers an explicit operator's dissipation
    cooling     |d ln E/dt| by dissipation
    collisions  one over the longest step of an explicit operator
    fluid       sum over the directions of space of (|u_n| + c)/h
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import gamma, inf, log1p
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rvm_mpi import kinetic_theory
from rvm_mpi.collisions.weights import SUPPORT
from rvm_mpi.units import power

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job
    from rvm_mpi.job.schema import Time

COOLING_CHANGE = 0.1
"""Largest relative change of a cell's energy by dissipation in one step."""
FLUID_CFL = 0.5
"""The fluid's own Courant number, up to which it keeps density and temperature positive."""
EXPLICIT_COLLISIONS = 0.2
"""Mean collisions in a step of an explicit operator; fast particles have a few times as many."""
SLACK = 1.02
"""A step may pass the Courant number by this factor before it is taken again, shorter."""
COLLAPSED = 1e-12
"""A step shorter than this part of the end time leads nowhere."""
DRIFT_SHARES = (1.0, 0.25, 0.0625)
"""Shares of the drift's rate that a step may be made for; what a cell has beyond, it takes in substeps."""
FITS = 1.05
"""Courant numbers up to this times the one wanted fit: neighbours in nearly the same state are to be treated alike."""
SUBSTEP = 0.3
"""Time of a substep of the drift over that of a cell's stage."""


# --- which limit binds


class Limit(NamedTuple):
    """One limit on the step."""

    name: str
    """What a run calls it."""
    words: str
    """What `rvm check` calls it."""
    cure: str = "take an earlier time.end"
    """What to do where it makes the step too short ever to arrive."""


GIVEN = Limit("time.dt", "time.dt", "take a longer one")
COURANT = Limit("transport and drift (cfl)", "time.cfl")
COOLING = Limit(
    "dissipation",
    "cooling (a tenth of the energy a step)",
    "take a larger collision.knudsen, a collision.restitution nearer to 1, or an earlier time.end",
)
END = Limit("end", "time.end: nothing else limits the step")
COLLISIONS = Limit(
    "collisions",
    "collisions, taken explicitly",
    "take a larger collision.knudsen, or collision.penalise = true, or an earlier time.end",
)
FLUID = Limit("fluid", "the fluid system's waves")


class Rates(NamedTuple):
    """The largest rates over all cells, 1/time; 0 where there is nothing of the kind."""

    courant: float = 0.0
    """Of transport and the share of the drift that the step is made for (`CellRates.at`)."""
    cooling: float = 0.0
    collisions: float = 0.0
    fluid: float = 0.0


def step_length(time: Time, rates: Rates, left: float) -> tuple[float, Limit]:
    """The longest step allowed, and the limit that sets it: the first of them where two are equal.

    Parameters
    ----------
    time : Time
        The job's `[time]`.
    rates : Rates
        Not looked at where the job fixes dt.
    left : float
        Time left to `time.end`.
    """
    if time.dt is not None or time.cfl is None:
        return float(time.dt or time.end), GIVEN
    longest = {
        COURANT: _longest(time.cfl, rates.courant),
        COOLING: _longest(COOLING_CHANGE, rates.cooling),
        END: left,
        COLLISIONS: _longest(1.0, rates.collisions),
        FLUID: _longest(FLUID_CFL, rates.fluid),
    }
    limit = min(longest, key=longest.__getitem__)
    return longest[limit], limit


def _longest(most: float, rate: float) -> float:
    return most / rate if rate > 0 else inf


def fit_to_stop(dt: float, left: float, fixed: bool) -> tuple[float, bool]:
    """A step shortened so that a time to stop at is hit exactly; two equal steps rather than a last tiny one.

    Parameters
    ----------
    dt, left : float
        The step, and the time left to the stop.
    fixed : bool
        Whether the job fixes dt: then only the last step is shortened.

    Returns
    -------
    tuple of (float, bool)
        The step, and whether it reaches the stop.
    """
    if dt >= left * (1.0 - 1e-9):
        return left, True
    return (0.5 * left if dt > 0.5 * left and not fixed else dt), False


def shorter_step(dt: float, rate: float, cfl: float | None) -> float | None:
    """The step to take in place of one that has turned out too long for its Courant number; None where it will do.

    Parameters
    ----------
    dt, rate : float
        The step, and the rate that its first stage measured, 1/time.
    cfl : float or None
        None where the job fixes dt.
    """
    if cfl is None or dt * rate <= SLACK * cfl:
        return None
    return 0.95 * cfl / rate


# --- transport and drift


class CellRates(NamedTuple):
    """Rates of each cell, arrays (ny, nx) or what broadcasts to them, 1/time."""

    transport: np.ndarray
    drift: np.ndarray
    answering: np.ndarray

    def at(self, share: float) -> np.ndarray:
        """The rate that, times dt, is a cell's Courant number in a step made for this share of the drift.

        What of the drift answers an explicit operator's dissipation counts in full: in a cooling gas the two balance,
        which substeps of one of them would miss by O(dt^2) in each step, always to the same side.
        """
        return self.transport + self.answering + share * (self.drift - self.answering)

    def largest(self) -> list[float]:
        """The largest of all cells for each of `DRIFT_SHARES`."""
        return [float(self.at(share).max()) for share in DRIFT_SHARES]


def answering_rate(cooling: np.ndarray, drift: np.ndarray, across: float) -> np.ndarray:
    """The part of a rescaled grid's drift that answers an explicit operator's dissipation.

    Parameters
    ----------
    cooling, drift : arrays (ny, nx)
        Rates of the cells: omega falls at half the cooling's.
    across : float
        Sum over the directions of velocity of V/h.
    """
    answering: np.ndarray = np.minimum(0.5 * cooling * across, drift)
    return answering


def choose_share(rates: Sequence[float], cells: CellRates, number: int, total: Callable[..., Sequence[float]]) -> int:
    """Which of `DRIFT_SHARES` to make the step for, the one that takes least time.

    A long step costs more than a short one, for the cells whose drift it takes in substeps.

    Parameters
    ----------
    rates : sequence of float
        `CellRates.largest`, over all cells.
    cells : CellRates
        Of the cells of this rank.
    number : int
        Of all cells.
    total : callable
        Sums each of its arguments over all ranks; called on all of them or on none.
    """
    if rates[0] <= rates[-1]:
        return 0
    substeps = total(*(drift_substeps(cells.transport, cells.drift, rate) for rate in rates))
    return int(np.argmin([rate * (number + SUBSTEP * count) for rate, count in zip(rates, substeps, strict=True)]))


def drift_substeps(transport: np.ndarray, drift: np.ndarray, rate: float) -> float:
    """Sum over cells of the substeps that their drift is taken in, with a step of one Courant number over `rate`.

    Parameters
    ----------
    transport, drift : arrays (ny, nx)
        Rates of the cells, 1/time.
    rate : float
    """
    if not rate > 0.0:
        return 0.0
    return float(np.where(transport + drift > FITS * rate, np.ceil(drift / rate), 0.0).sum())


# --- collisions


def collision_rate(job: Job, density: np.ndarray, temperature: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """One over the longest step of an explicit Boltzmann operator, in each cell; zero where nothing limits it.

    So many mean collisions as `EXPLICIT_COLLISIONS`, and one of the fastest pair that the operator knows, 2 R apart.
    """
    if not job.collision.explicit or job.collision.penalise:
        return np.zeros_like(density)
    mean = collision_frequency(job, density, temperature)
    return np.maximum(mean / EXPLICIT_COLLISIONS, fastest_rate(job, density, omega))


def collision_frequency(job: Job, density: np.ndarray, temperature: np.ndarray) -> np.ndarray:
    """Collisions per unit time, Knudsen number included; arrays of one shape."""
    collision, d = job.collision, job.velocity.dimensions
    assert collision.knudsen is not None
    if collision.relaxation is not None:
        law = collision.relaxation
        rate = law.coefficient * power(density, law.density_power) * power(temperature, law.temperature_power)
    else:
        assert collision.cross_section is not None and collision.exponent is not None
        exponent = collision.exponent
        mean_power = power(4 * temperature, exponent / 2) * gamma((d + exponent) / 2) / gamma(d / 2)
        rate = density * collision.cross_section * kinetic_theory.sphere_area(d) * mean_power
    return rate / collision.knudsen


def fastest_rate(job: Job, density: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Collisions per unit time of the fastest pair that the Boltzmann operator knows; arrays of one shape."""
    collision = job.collision
    assert collision.cross_section is not None and collision.exponent is not None and collision.knudsen is not None
    widest = 2.0 * SUPPORT * job.velocity.half_width[0] * omega
    sphere = collision.cross_section * kinetic_theory.sphere_area(job.velocity.dimensions)
    return sphere / collision.knudsen * density * power(widest, collision.exponent)


# --- how many steps


def stretched_time(job: Job, rate: float) -> Callable[[float], float]:
    """A function of time that grows about as fast as the number of steps: log(1 + a t)/a where steps grow as 1 + a t.

    They do where the grid shrinks with a gas that cools by Haff's law, T = T(0)/(1 + a t)^2.

    Parameters
    ----------
    job : Job
    rate : float
        Mean of density times the square root of the temperature at the start.
    """
    if job.scaling.kind == "none" or job.time.dt is not None or job.collision.elastic:
        return lambda time: time
    haff = job.collision.cooling * rate
    return lambda time: log1p(haff * time) / haff
