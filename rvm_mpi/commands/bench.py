"""Throughput of the step on this machine, beside the machine's own memory and arithmetic limits in the same run.

Absolute times vary by the hour on shared machines; the ratio of the time of a phase-space cell and stage to the time of
an element of the triad a = b + s c, measured alternately, hardly does.
"""

from __future__ import annotations

import json
import statistics
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rvm_mpi.compiling.declare import kernel
from rvm_mpi.compiling.simd import fma, load, splat, store, total
from rvm_mpi.grid.domain import aligned
from rvm_mpi.job.job import Job
from rvm_mpi.terminal import answer

#: doubles of each of the triad's three arrays: far more than a core's share of any cache
TRIAD_SIZE = 16_000_000
ROUNDS = 5
STAGES = 2
#: Courant number of a step
CFL = 0.5
#: what a stage moves of a phase-space cell at least: g of both time levels read, the new one written
BYTES = 24.0
#: vector instructions that a phase-space cell takes in a stage, counted in the sources, each as a fused multiply-add:
#: through the faces in a direction of space, in the drift along one of velocity, all else (moments, the correction,
#: the Gaussian, the mixing of stages)
OPERATIONS = {"space": 25, "velocity": 30, "else": 45}


@kernel
def _triad(a, b, c, s):  # type: ignore[no-untyped-def]
    for n in range(0, a.size, 8):
        store(a, n, load(b, n) + load(c, n) * s)


@kernel
def _multiply_add(rounds, s, result):  # type: ignore[no-untyped-def]
    """Eight chains of fused multiply-adds on whole vectors: 128 operations a round."""
    a, b, c, d = splat(1.0), splat(2.0), splat(3.0), splat(4.0)
    e, f, g, h = splat(5.0), splat(6.0), splat(7.0), splat(8.0)
    k = splat(s)
    for _ in range(rounds):
        a, b, c, d = fma(a, k, k), fma(b, k, k), fma(c, k, k), fma(d, k, k)
        e, f, g, h = fma(e, k, k), fma(f, k, k), fma(g, k, k), fma(h, k, k)
    result[0] = total(a + b + c + d + e + f + g + h)


@dataclass(frozen=True)
class BenchResult:
    """Medians over the rounds, on the slowest rank; times in nanoseconds.

    Attributes
    ----------
    triad_ns, triad_gb_per_s : time per element of the triad and its bandwidth (24 bytes an element), a core
    gflops : fused multiply-adds, two operations each, a core
    stage_ns : of a phase-space cell and stage in the kinetic stages alone, ghost exchange included, a core
    uncorrected_ns : the same without the conservative correction of g
    step_ns : the same from whole steps: with the fluid, diagnostics and all, and the drift in substeps where that pays
    stage_per_triad, uncorrected_per_triad, step_per_triad : ratios, the median over the rounds of each round's own
    roofline_ns : what a stage takes at least, the longer of `BYTES` at the triad's bandwidth and `OPERATIONS` at the
        rate of fused multiply-adds
    roofline_share : the part of `stage_ns` that it is
    cells_per_second : phase-space cell stages per second of all ranks together, whole steps
    """

    cells: tuple[int, ...]
    velocity: tuple[int, ...]
    ranks: int
    triad_ns: float
    triad_gb_per_s: float
    gflops: float
    stage_ns: float
    uncorrected_ns: float
    step_ns: float
    stage_per_triad: float
    uncorrected_per_triad: float
    step_per_triad: float
    roofline_ns: float
    roofline_share: float
    cells_per_second: float


def run_bench(cells: tuple[int, ...] = (64, 64), velocity: tuple[int, ...] = (24, 24, 8), as_json: bool = False) -> int:
    """Measure and print (rank 0); all ranks take part.

    Parameters
    ----------
    cells, velocity : tuple of int
        The grids; the physics is that of Test 4 with the kinetic scaling.
    as_json : bool
        Print one JSON object instead of lines.

    Returns
    -------
    int
        0
    """
    result, rank = measure(tuple(cells), tuple(velocity))
    if rank == 0:
        answer(json.dumps(asdict(result)) if as_json else _lines(result))
    return 0


def measure(cells: tuple[int, ...], velocity: tuple[int, ...]) -> tuple[BenchResult, int]:
    """The result, the same on every rank, and this rank's number."""
    from rvm_mpi.simulation import Simulation

    simulation = Simulation(_job(cells, velocity))
    domain, kinetic = simulation.domain, simulation.kinetic
    nx, ny = domain.local
    own = nx * ny * int(np.prod(velocity))
    arrays = [aligned((TRIAD_SIZE,)) for _ in range(3)]
    for array in arrays:
        array[:] = 1.0
    sink = np.zeros(1)
    simulation.advance()
    _triad(*arrays, 2.0)
    _multiply_add(10, 0.5, sink)
    rounds = 2_000_000
    triads: list[float] = []
    stages: list[float] = []
    uncorrected: list[float] = []
    steps: list[float] = []
    flops: list[float] = []
    for _ in range(ROUNDS):
        triad = _timed(domain.comm, lambda: _triad(*arrays, 2.0)) / TRIAD_SIZE
        dt = 0.9 * CFL / kinetic.rates[0]  # no cell takes its drift in substeps

        def both_stages(dt: float = dt) -> None:
            kinetic.first_stage(dt)
            kinetic.later_stages(dt)

        stage = _timed(domain.comm, both_stages) / (STAGES * own)
        model = kinetic.model
        kinetic.model = model._replace(conservative=False)
        plain = _timed(domain.comm, both_stages) / (STAGES * own)
        kinetic.model = model
        step = _timed(domain.comm, simulation.advance) / (STAGES * own)
        flop = 128.0 * rounds / _timed(domain.comm, lambda: _multiply_add(rounds, 0.5, sink))
        for series, value in (
            (triads, triad),
            (stages, stage),
            (uncorrected, plain),
            (steps, step),
            (flops, flop),
        ):
            series.append(value)
    triad_ns, stage_ns, plain_ns, step_ns, negative_gflops, by_stage, by_plain, by_step = domain.maximum(
        1e9 * statistics.median(triads),
        1e9 * statistics.median(stages),
        1e9 * statistics.median(uncorrected),
        1e9 * statistics.median(steps),
        -1e-9 * statistics.median(flops),
        statistics.median(a / b for a, b in zip(stages, triads)),
        statistics.median(a / b for a, b in zip(uncorrected, triads)),
        statistics.median(a / b for a, b in zip(steps, triads)),
    )
    operations = OPERATIONS["space"] * len(cells) + OPERATIONS["velocity"] * len(velocity) + OPERATIONS["else"]
    roofline_ns = max(BYTES / 24.0 * triad_ns, operations * 2.0 / -negative_gflops)
    return (
        BenchResult(
            cells=cells,
            velocity=velocity,
            ranks=domain.size,
            triad_ns=triad_ns,
            triad_gb_per_s=24.0 / triad_ns,
            gflops=-negative_gflops,
            stage_ns=stage_ns,
            uncorrected_ns=plain_ns,
            step_ns=step_ns,
            stage_per_triad=by_stage,
            uncorrected_per_triad=by_plain,
            step_per_triad=by_step,
            roofline_ns=roofline_ns,
            roofline_share=roofline_ns / stage_ns,
            cells_per_second=1e9 * domain.size / step_ns,
        ),
        domain.rank,
    )


def _timed(comm: Any, action: Any) -> float:
    comm.Barrier()
    begin = time.perf_counter()
    action()
    return time.perf_counter() - begin


def _job(cells: tuple[int, ...], velocity: tuple[int, ...]) -> Job:
    collision: dict[str, Any] = {"operator": "granular-es-bgk", "knudsen": 0.01, "restitution": 0.99}
    if len(velocity) == 1:
        collision["relaxation"] = {"coefficient": 3.78, "density_power": 1, "temperature_power": 0.5}
    state = {"state": "random-density", "low": 0.2} if cells else {"state": "uniform"}
    return Job.from_dict(
        {
            "title": "bench",
            "space": {"cells": list(cells)},
            "velocity": {"points": list(velocity)},
            "collision": collision,
            "fluid": {"enabled": True},
            "initial": state,
            "time": {"end": 1e6, "cfl": CFL},
        },
        name="bench",
    )


def _lines(r: BenchResult) -> str:
    shape = " x ".join(map(str, r.cells)) or "1"
    grid = " x ".join(map(str, r.velocity))
    each = "ns a phase-space cell and stage"
    return "\n".join(
        [
            f"{shape} cells, {grid} velocities, {r.ranks} {'rank' if r.ranks == 1 else 'ranks'}; figures a core",
            f"memory, triad      {r.triad_ns:8.3f} ns an element    {r.triad_gb_per_s:8.1f} GB/s",
            f"arithmetic, FMA    {1 / r.gflops:8.4f} ns an operation  {r.gflops:8.1f} GFLOP/s",
            f"kinetic stages     {r.stage_ns:8.3f} {each} = {r.stage_per_triad:.2f} x triad",
            f"  roofline         {r.roofline_ns:8.3f} {each}; {100 * r.roofline_share:.0f} % of it reached",
            f"  uncorrected      {r.uncorrected_ns:8.3f} {each} = {r.uncorrected_per_triad:.2f} x triad",
            f"whole step         {r.step_ns:8.3f} {each} = {r.step_per_triad:.2f} x triad",
            f"throughput         {r.cells_per_second / 1e6:8.1f} M phase-space cell stages a second on all ranks",
        ]
    )
