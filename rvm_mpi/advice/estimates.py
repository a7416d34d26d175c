"""What can be said of a job before it runs: whether its velocity box fits, memory, steps, time, physics.

Estimates look at the initial state alone and say so; nothing here starts MPI.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import ROUND_CEILING, Decimal
from math import ceil, inf, isfinite, nan, pi, prod, sqrt
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi import kinetic_theory, time_limits
from rvm_mpi.collisions.weights import Rows
from rvm_mpi.job.text import JobError
from rvm_mpi.states import macroscopic_state
from rvm_mpi.step import fit
from rvm_mpi.time_limits import COLLAPSED, COURANT, CellRates, Limit, Rates

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

LIBRARIES = 239e6
"""Bytes a process holds beside its arrays: Python, numba and kernels, PETSc, MPI, HDF5 (benchmarks/memory.py)."""
TRIAD_SIZE = 4_000_000
"""Doubles of each of the three arrays that `triad_seconds` sums: more than a core's share of most caches."""
STAGE_PER_TRIAD = ((4608, 3.5), (13824, 3.9), (32768, 4.5))
"""Time of a stage for a phase-space cell over that of a triad's element, by velocities (benchmarks/stages.py)."""
STAGE_WITH_DRIFT = {"van-leer": 1.0, "kappa": 1.55, "seventh-order": 1.55, "seventh-order-positive": 1.75}
"""Time of a stage with each reconstruction of the drift over that with Van Leer's (benchmarks/drift_cost.py)."""
STEP_PER_STAGES = 1.13
"""Time of a step over that of its stages: halo, fluid, reductions, diagnostics (benchmarks/step_parts.py)."""
SECONDS_PER_STEP = 2e-3
"""Nominal time of what a step costs whatever the grid: calls, reductions, a row of the history."""
OPERATIONS_PER_PAIR = 10
"""Floating-point operations of the Boltzmann operator's sum for a pair of modes (`boltzmann_weights.Rows.products`)."""
OPERATIONS_PER_SECOND = 5.5e10
"""Nominal speed of that sum on one core: two thirds of the peak of one with AVX-512 (benchmarks/boltzmann.py)."""
SECONDS_PER_NODE = 6e-9
"""Nominal time of that operator's transforms and of its packing, a velocity node."""
STAGES = 2
GHOSTS_OF_G = 2
GHOSTS_OF_FLUID = 3
LANES = 8
MAKING_WEIGHTS = 8
"""Memory that making the Boltzmann operator's weights takes for a moment, over that of the weights."""
STANDARD_DEVIATIONS = 3.0
"""A box must hold the state this many thermal speeds around its mean velocity: one in 400 lies outside."""
COARSE = 0.1
"""Share of the gas in cells wider than its mean free path from which `rvm check` speaks of them."""
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
    for _, density, velocity, tensor in _initial_rows(job):
        variance = np.diagonal(tensor, axis1=-2, axis2=-1).copy()
        parts.append((density, velocity, variance, fit.scaled(job, velocity, tensor).omega))
    density, velocity, variance, omega = (np.concatenate(part) for part in zip(*parts, strict=True))
    return StartFields(density, variance.mean(-1), velocity, np.sqrt(variance), omega)


def _initial_rows(job: Job) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """The initial state by blocks of rows: the first row, density, velocity and temperature tensor."""
    nx, ny = (*job.space.cells, 1, 1)[:2]
    rows = max(1, ROWS_AT_ONCE // nx)
    for j in range(0, ny, rows):
        yield (j, *macroscopic_state(job, 0, nx, j, min(ny, j + rows)))


# --- the velocity grid


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


def check_start(job: Job, ranks: int) -> None:
    """Refuse what cannot start, for `rvm check` and `rvm run` alike.

    The number of ranks, the state, the sides, a grid far too coarse for the operator, the weights, the first step.

    Raises
    ------
    JobError
        Naming the key and what would do.
    """
    from rvm_mpi.advice.accuracy import check_grid
    from rvm_mpi.grid.domain import partition

    partition(job.space.cells, ranks)
    check_box(job)
    check_grid(job)
    check_weights(job)
    check_first_step(job)


def check_box(job: Job) -> None:
    """Refuse a velocity grid too small or too coarse for the initial state or for a side's.

    Raises
    ------
    JobError
        Naming the direction and the half width or the number of points that would do.
    """
    start = start_fields(job)
    scale = start.omega[..., None]
    _check_width(job, "the initial state", start.velocity / scale, start.thermal / scale)
    for j, density, velocity, tensor in _initial_rows(job):
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
    if job.scaling.kind == "none" or job.velocity.dimensions == 1:
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


# --- memory, steps, time


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
    if job.collision.operator == "boltzmann":
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
    from rvm_mpi.grid.domain import partition

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
    if job.collision.operator != "boltzmann":
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
    across = sum(width / h for width, h in zip(velocity.half_width, velocity.spacing, strict=True))
    drift *= across
    growth = _growth(job, start) * across
    drift += growth
    drag, answering = np.zeros(start.omega.shape), np.zeros(start.omega.shape)
    haff = _haff_rate(job, start)
    if job.collision.operator == "boltzmann" and job.scaling.kind != "none":
        drift += haff * across  # by d_t omega, which no drag cancels
        answering = time_limits.answering_rate(2 * haff, drift, across)
    if job.scaling.kind == "none" and job.collision.operator != "boltzmann":
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
        if job.collision.operator == "boltzmann":
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
    if job.scaling.kind != "kinetic":
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


def steps(job: Job) -> float:
    """Number of steps to `time.end` at the least: of the length they have once the start has smoothed out.

    Where the grid is rescaled they grow as the gas cools by Haff's law.
    """
    start = start_fields(job)
    rate = float((start.density * np.sqrt(start.temperature)).mean())
    number = time_limits.stretched_time(job, rate)(job.time.end) / first_step(job).later
    if job.time.max_steps is not None:
        number = min(number, job.time.max_steps)
    return max(1.0, number)


def triad_seconds() -> float:
    """Seconds that an element of the triad a = b + c takes on this machine's memory, measured: some 0.1 s."""
    a, b, c = (np.ones(TRIAD_SIZE) for _ in range(3))
    least = inf
    for _ in range(5):
        begin = perf_counter()
        np.add(b, c, out=a)
        least = min(least, perf_counter() - begin)
    return least / TRIAD_SIZE


def run_seconds(job: Job, ranks: int, triad: float) -> float:
    """Wall-clock seconds of a run at the least, from `steps`, on so many cores with so fast a triad (`triad_seconds`).

    The Boltzmann operator's speed is a nominal one.
    """
    velocities, ratios = zip(*STAGE_PER_TRIAD, strict=True)
    ratio = float(np.interp(np.log(prod(job.velocity.points)), np.log(velocities), ratios))
    ratio *= STAGE_WITH_DRIFT[job.scheme.drift] * STEP_PER_STAGES
    cells = prod(job.space.cells) * cell_block(job.velocity.points)
    stage = cells * ratio * triad / ranks + operator_seconds(job, ranks)
    return steps(job) * (STAGES * stage + SECONDS_PER_STEP)


def operator_seconds(job: Job, ranks: int = 1) -> float:
    """Seconds of one evaluation of the Boltzmann operator on the rank with the most cells; 0 for other operators.

    It takes eight cells at a time: one alone costs as much as eight.
    """
    if job.collision.operator != "boltzmann":
        return 0.0
    n_x, n_y = largest_share(job, ranks)
    points = tuple(job.velocity.points)
    pairs = OPERATIONS_PER_PAIR * Rows.create(points).products / OPERATIONS_PER_SECOND
    return ceil(n_x * n_y / LANES) * LANES * (pairs + prod(points) * SECONDS_PER_NODE)


# --- physics


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


def mean_state(start: StartFields) -> tuple[float, float]:
    """Mean density, and mean temperature by mass."""
    mass = start.density / start.density.mean()
    return float(start.density.mean()), float((mass * start.temperature).mean())


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


def duration_in_words(seconds: float) -> str:
    """A rough duration: "12 s", "5 min", "3.5 h", "2 days"."""
    if not isfinite(seconds):
        return "for ever"
    for unit, length in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.3g} s"


def bytes_in_words(size: float) -> str:
    """A size: "12 MB", "3.4 GB"."""
    for unit, length in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if size >= length:
            return f"{size / length:.3g} {unit}"
    return f"{size / 1e3:.3g} kB"
