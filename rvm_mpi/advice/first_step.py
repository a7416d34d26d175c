"""The first time step, from the rates of the initial state and the limits that a run obeys (`time_limits.py`)."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi import time_limits
from rvm_mpi.advice.initial import StartFields, start_fields
from rvm_mpi.job.text import JobError
from rvm_mpi.time_limits import COLLAPSED, COURANT, CellRates, Limit, Rates

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job


@dataclass(frozen=True)
class FirstStep:
    """The first time step as far as the initial state alone decides it."""

    dt: float
    binding: Limit
    """Which limit binds."""
    limit: str
    """The same in words."""
    transport_rate: float
    """Sum over the space directions of omega V / dx, largest over the cells."""
    drift_rate: float
    """Sum over the velocity directions of |a| / h, largest over the cells."""
    growth_rate: float
    """The part of the drift rate that is |d omega/dt| / omega times sum V / h, largest over the cells."""
    cooling_rate: float
    """|d ln E/dt|, largest over the cells."""
    later: float
    """The step once jumps of the start have smoothed out: without the drift that omega's changes cause."""


def first_step(job: Job) -> FirstStep:
    """The first step that `time_limits` allows with the rates of the initial state."""
    start = start_fields(job)
    cells, growth, drag = _cell_rates(job, start)
    largest = cells.largest()
    share = time_limits.choose_share(largest, cells, start.omega.size, lambda *counts: counts)
    rates = Rates(
        courant=largest[share],
        cooling=float(_cooling_rate(job, start).max()),
        collisions=float(time_limits.collision_rate(job, start.density, start.temperature, start.omega).max()),
        fluid=_fluid_rate(job, start) if job.fluid.enabled else 0.0,
    )
    dt, binding = time_limits.step_length(job.time, rates, job.time.end)
    lasting = CellRates(cells.transport, cells.answering + drag, cells.answering)
    later = float(lasting.at(time_limits.DRIFT_SHARES[share]).max())
    return FirstStep(
        dt=dt,
        binding=binding,
        limit=_in_words(binding, cells, time_limits.DRIFT_SHARES[share]),
        transport_rate=float(cells.transport.max()),
        drift_rate=float(cells.drift.max()),
        growth_rate=float(growth.max()),
        cooling_rate=rates.cooling,
        later=time_limits.step_length(job.time, rates._replace(courant=later), job.time.end)[0],
    )


def _in_words(binding: Limit, cells: CellRates, share: float) -> str:
    """The limit, and what makes most of the rate where that is transport and drift."""
    if binding != COURANT:
        return binding.words
    worst = np.unravel_index(np.argmax(cells.at(share)), cells.drift.shape)
    drift = cells._replace(transport=np.zeros(())).at(share)[worst]
    return f"{binding.words}, mostly {'transport in space' if cells.transport[worst] >= drift else 'drift in velocity'}"


def _cell_rates(job: Job, start: StartFields) -> tuple[CellRates, np.ndarray, np.ndarray]:
    """Rates of the initial state's cells; of the drift's, what d omega/dt and what the cooling's drag make.

    The drift takes grad omega from differences of neighbouring cells. d_t omega cancels the cooling's drag; what
    streams in from the neighbours adds to it in the kinetic scaling.
    """
    velocity, space = job.velocity, job.space
    transport, drift = np.zeros(start.omega.shape), np.zeros(start.omega.shape)
    for axis in range(space.dimensions):
        transport += start.omega * velocity.half_width[axis] / space.spacing[axis]
        drift += velocity.half_width[axis] * np.abs(_slope(start.omega, axis, job))
    if job.scaling.kind == "thermal":
        for axis in range(space.dimensions):
            transport += np.abs(start.velocity[..., axis]) / space.spacing[axis]
    across = sum(width / h for width, h in zip(velocity.half_width, velocity.spacing, strict=True))
    drift *= across
    if job.scaling.kind == "thermal":
        for axis in range(space.dimensions):
            for component, h in enumerate(velocity.spacing):
                shear = np.abs(_slope(start.velocity[..., component], axis, job))
                drift += velocity.half_width[axis] / h * shear
    growth = _growth(job, start) * across
    drift += growth
    drag, answering = np.zeros(start.omega.shape), np.zeros(start.omega.shape)
    if job.collision.explicit and job.scaling.kind != "none":
        cooling = _cooling_rate(job, start)
        drift += 0.5 * cooling * across  # by d_t omega, which no drag cancels
        answering = time_limits.answering_rate(cooling, drift, across)
    if job.scaling.kind == "none" and not job.collision.explicit:
        haff = _haff_rate(job, start)
        for axis, h in enumerate(velocity.spacing):
            drag += haff * (velocity.half_width[axis] + np.abs(start.velocity[..., axis])) / h
        drift += drag
    return CellRates(transport, drift, answering), growth, drag


def _haff_rate(job: Job, start: StartFields) -> np.ndarray:
    """|d ln sqrt(T)/dt| by dissipation, each cell by itself."""
    return job.collision.cooling * start.density * np.sqrt(start.temperature)


def _cooling_rate(job: Job, start: StartFields) -> np.ndarray:
    """|d ln E/dt| by dissipation."""
    d = job.velocity.dimensions
    energy = d * start.temperature + (start.velocity**2).sum(-1)
    rate: np.ndarray = 2 * _haff_rate(job, start) * d * start.temperature / energy
    return rate


def check_first_step(job: Job) -> None:
    """Refuse a job whose first step leads nowhere, as the run would.

    Raises
    ------
    JobError
        Naming what limits the step, and what would do.
    """
    with np.errstate(over="ignore"):
        first = first_step(job)
        if job.collision.explicit:
            start = start_fields(job)
            rates = time_limits.collision_frequency(job, start.density, start.temperature)
            rates = rates + time_limits.fastest_rate(job, start.density, start.omega)
            if not np.isfinite(rates).all():
                raise JobError(f"{job.name}: collision.knudsen: too small: the collision rate overflows")
    if first.dt >= COLLAPSED * job.time.end:
        return
    raise JobError(
        f"{job.name}: the first time step would be {first.dt:.3g} long, limited by {first.limit}: too short ever to "
        f"reach time.end = {job.time.end:g} (allowed at least {COLLAPSED:g} of it); {first.binding.cure}"
    )


def _growth(job: Job, start: StartFields) -> np.ndarray:
    """|d omega/dt| / omega by what streams between cells, where omega follows the kinetic moments.

    Through a face each Maxwellian at rest sends the mass rho sqrt(T / 2 pi) and (d + 1)/2 T of energy with
    each unit of it, more than the d/2 T of the gas it joins: a nearly empty cell beside a full one is heated
    at once.
    """
    growth = np.zeros(start.omega.shape)
    if job.scaling.kind not in ("kinetic", "thermal"):
        return growth
    d = job.velocity.dimensions
    mass = start.density * np.sqrt(start.temperature / (2 * pi))
    energy = mass * start.temperature * (d + 1) / 2
    for axis, h in enumerate(job.space.spacing):
        mass_in, energy_in = (_neighbours(flux, axis, job) - 2 * flux for flux in (mass, energy))
        held = start.density * start.temperature * d / 2
        growth += 0.5 * np.abs(energy_in / held - mass_in / start.density) / h
    return growth


def _neighbours(values: np.ndarray, axis: int, job: Job) -> np.ndarray:
    """Sum of both neighbours along x (0) or y (1); beyond a boundary not periodic the cell itself."""
    array_axis = 1 - axis
    below, above = np.roll(values, 1, array_axis), np.roll(values, -1, array_axis)
    if not job.space.periodic(axis):
        first = (slice(None),) * array_axis + (0,)
        last = (slice(None),) * array_axis + (-1,)
        below[first], above[last] = values[first], values[last]
    return below + above


def _slope(omega: np.ndarray, axis: int, job: Job) -> np.ndarray:
    """Centred differences of omega along x (0) or y (1), one-sided at a boundary that is not periodic."""
    array_axis, h = 1 - axis, job.space.spacing[axis]
    if job.space.periodic(axis):
        return (np.roll(omega, -1, array_axis) - np.roll(omega, 1, array_axis)) / (2 * h)
    return np.asarray(np.gradient(omega, h, axis=array_axis))


def _fluid_rate(job: Job, start: StartFields) -> float:
    d = job.velocity.dimensions
    sound = np.sqrt((d + 2) / d * start.temperature)
    rate = np.zeros(start.omega.shape)
    for axis, h in enumerate(job.space.spacing):
        rate += (np.abs(start.velocity[..., axis]) + sound) / h
    return float(rate.max())
