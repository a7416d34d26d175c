"""How many steps a job takes, and how long they take on this machine."""

from __future__ import annotations

from math import ceil, inf, isfinite, prod
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi import time_limits
from rvm_mpi.advice.first_step import first_step
from rvm_mpi.advice.initial import start_fields
from rvm_mpi.advice.memory import LANES, cell_block, largest_share
from rvm_mpi.collisions.weights import Rows

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

TRIAD_SIZE = 4_000_000
"""Doubles of each of the three arrays that `triad_seconds` sums: more than a core's share of most caches."""
STAGE_PER_TRIAD = ((4608, 3.5), (13824, 3.9), (32768, 4.5))
"""Time of a stage for a phase-space cell over that of a triad's element, by velocities (benchmarks/stages.py)."""
STAGE_WITH_DRIFT = {
    "maxwellian": 1.3,
    "van-leer": 1.0,
    "seventh-order": 1.55,
    "seventh-order-positive": 1.75,
}
"""Time of a stage with each reconstruction of the drift over that with Van Leer's (benchmarks/drift_cost.py)."""
STEP_PER_STAGES = 1.13
"""Time of a step over that of its stages: halo, fluid, reductions, diagnostics (benchmarks/step_parts.py)."""
SECONDS_PER_STEP = 2e-3
"""Nominal time of what a step costs whatever the grid: calls, reductions, a row of the history."""
OPERATIONS_PER_PAIR = 10
"""Floating-point operations of the Boltzmann operator's sum for a pair of modes (`weights.Rows.products`)."""
OPERATIONS_PER_SECOND = 5.5e10
"""Nominal speed of that sum on one core: two thirds of the peak of one with AVX-512 (benchmarks/boltzmann.py)."""
SECONDS_PER_NODE = 6e-9
"""Nominal time of that operator's transforms and of its packing, a velocity node."""
STAGES = 2


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
    if not job.collision.explicit:
        return 0.0
    n_x, n_y = largest_share(job, ranks)
    points = tuple(job.velocity.points)
    pairs = OPERATIONS_PER_PAIR * Rows.create(points).products / OPERATIONS_PER_SECOND
    return ceil(n_x * n_y / LANES) * LANES * (pairs + prod(points) * SECONDS_PER_NODE)


def duration_in_words(seconds: float) -> str:
    """A rough duration: "12 s", "5 min", "3.5 h", "2 days"."""
    if not isfinite(seconds):
        return "for ever"
    for unit, length in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.1f} {unit}"
    return f"{seconds:.3g} s"
