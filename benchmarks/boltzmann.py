"""Cost of the direct Boltzmann operator beside this machine's own limits for what it does: half a minute to run.

`python benchmarks/boltzmann.py`, with `--large` for 24 and 32 points a direction in d = 3 (half a minute more).

The limit is the sum of three times that are measured in the same rounds as the operator, all in cache:

- FFTW: real transforms there and back, the fastest plan (FFTW_MEASURE) of those with eight cells innermost or each cell
  by itself, eight cells at a time or a cacheful;
- packing: the bytes that must be read and written between the blocks of g, the transforms and the sum, at the
  speed of a copy;
- arithmetic: a pair of modes needs 10 operations on complex numbers with a real weight, in two multiplications and four
  fused multiply-adds, six instructions at the speed of fused multiply-adds.
"""

import argparse
import sys
import time
from math import prod
from pathlib import Path

import numpy as np
import pyfftw

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi import Job, Simulation
from rvm_mpi.collisions.boltzmann import BATCH_NODES, Modes, add_pairs
from rvm_mpi.commands.bench import _multiply_add
from rvm_mpi.compiling.declare import kernel
from rvm_mpi.compiling.simd import LANES, load, store

GRIDS = [(n,) * d for d, sizes in ((1, (16, 32, 64)), (2, (16, 32, 64)), (3, (8, 12, 16))) for n in sizes]
LARGE = [(24,) * 3, (32,) * 3]
INSTRUCTIONS = 6
#: cells of a small rank
CELLS = 64
ROUNDS = 10
#: seconds of one measurement of a round, at least one call
SHARE = 0.01
MULTIPLY_ADDS = 100_000
COPIES = 20


@kernel
def copies(count, source, target):
    for _ in range(count):
        for n in range(0, source.size, LANES):
            store(target, n, load(source, n))


@kernel
def sums(count, double_sum, highest, g, q):
    for _ in range(count):
        add_pairs(double_sum, highest, g, q)


def alternated(functions):
    """Least processor seconds of a call of each, over rounds in which all are called in turn."""
    repeats, least = {}, dict.fromkeys(functions, np.inf)
    for name, function in functions.items():
        function()
        start = time.thread_time()
        function()
        repeats[name] = max(1, int(SHARE / max(time.thread_time() - start, 1e-7)))
    for _ in range(ROUNDS):
        for name, function in functions.items():
            start = time.thread_time()
            for _ in range(repeats[name]):
                function()
            least[name] = min(least[name], (time.thread_time() - start) / repeats[name])
    return least


def fast_transforms(points):
    """FFTW there and back by layout and number of cells: what to call, and how many cells that serves."""
    found = {}
    half = (*points[:-1], points[-1] // 2 + 1)
    for cells in {LANES, max(1, BATCH_NODES // prod(points)) * LANES}:
        for innermost in (True, False):
            shapes = [(cells // LANES, *s, LANES) if innermost else (cells, *s) for s in (points, half)]
            real = pyfftw.zeros_aligned(shapes[0], dtype="float64", n=64)
            modes = pyfftw.zeros_aligned(shapes[1], dtype="complex128", n=64)
            options = {"axes": tuple(range(1, 1 + len(points))), "flags": ("FFTW_MEASURE", "FFTW_DESTROY_INPUT")}
            there = pyfftw.FFTW(real, modes, direction="FFTW_FORWARD", **options)
            back = pyfftw.FFTW(modes, real, direction="FFTW_BACKWARD", **options)
            real[...] = 1.0

            def both(there=there, back=back):
                there.execute()
                back.execute()

            found["fftw", cells, innermost] = both, cells
    return found


def packed_bytes(points):
    """What a cell's packing reads and writes: g, the half spectra, the modes kept, and all of that back again."""
    spectrum = 16 * prod(points[:-1]) * (points[-1] // 2 + 1)
    modes = [2 * ((n - 1) // 2) + 1 for n in points]
    kept = 16 * prod(modes[:-1]) * (modes[-1] // 2 + 1)
    there = 2 * 8 * prod(points) + kept + 16 * prod(modes)
    back = kept + spectrum + 2 * 8 * prod(points)
    return there + back


def kinetic_part(points):
    """The kinetic part of a simulation with this operator."""
    job = {
        "space": {"cells": [CELLS] if len(points) == 1 else [8, CELLS // 8]},
        "velocity": {"points": list(points), "half_width": 7.0},
        "collision": {"operator": "boltzmann", "knudsen": 1.0, "restitution": 0.9},
        "initial": {"state": "uniform"},
        "time": {"end": 1.0},
    }
    return Simulation(Job.from_dict(job, name="benchmark")).kinetic


def measure(points):
    kinetic = kinetic_part(points)
    op = kinetic._operator._operator
    many = max(CELLS, 2 * BATCH_NODES // prod(points) * LANES)
    g = np.random.default_rng(1).random((many, *points))
    out = np.empty_like(g)
    count = max(1, 200_000 // op.rows.products)
    modes = [Modes(*pyfftw.ones_aligned((2, op._work["modes"][0].re.size), n=64)) for _ in range(2)]
    source, target = (pyfftw.ones_aligned(BATCH_NODES * LANES, n=64) for _ in range(2))
    sink = np.zeros(1)
    parts = {
        "few": (lambda: op.collide(g[:CELLS], out[:CELLS]), CELLS),
        "many": (lambda: op.collide(g, out), many),
        "one": (lambda: op.collide(g[:1], out[:1]), 1),
        "stage": (lambda: kinetic._operator.collide(kinetic, kinetic.g, kinetic.now), CELLS),
        "sum": (lambda: sums(count, op._work["double_sum"], op.rows.modes[2], *modes), count * LANES),
        "copy": (lambda: copies(COPIES, source, target), COPIES * 2 * source.nbytes),
        "fma": (lambda: _multiply_add(MULTIPLY_ADDS, 0.5, sink), MULTIPLY_ADDS * 128 / 2),
        **fast_transforms(points),
    }
    times = alternated({name: function for name, (function, _) in parts.items()})
    us = {name: 1e6 * times[name] / parts[name][1] for name in parts}
    fftw = min(us[name] for name in parts if name[0] == "fftw")
    packing = packed_bytes(points) * us["copy"]
    arithmetic = INSTRUCTIONS * op.rows.products * us["fma"]
    limit = fftw + packing + arithmetic
    figures = [fftw, packing, arithmetic, limit, us["many"], us["many"] / limit, us["few"], us["few"] / limit]
    figures += [us["stage"], us["stage"] / limit, us["one"], us["sum"] / arithmetic]
    print(
        f"| {' x '.join(map(str, points))} | {op.weights.nbytes / 1e6:.2g} | {many} "
        f"| {' | '.join(f'{x:.3g}' for x in figures)} | {2e-3 / us['fma']:.0f} | {1e-3 / us['copy']:.0f} |",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--large", action="store_true", help="24 and 32 points a direction in d = 3, too")
    large = parser.parse_args().large
    columns = [
        *("points", "weights, MB", "many", "FFTW", "packing", "arithmetic", "limit", "operator, many cells"),
        *("over the limit", f"{CELLS} cells", "over the limit", f"in a stage, {CELLS} cells", "over the limit"),
        *("one cell", "sum over its arithmetic", "peak, GFlop/s", "copy in cache, GB/s"),
    ]
    print("us a cell and evaluation, one core; least processor times of rounds\n")
    print(f"| {' | '.join(columns)} |\n|{' --- |' * len(columns)}")
    for points in GRIDS + LARGE * large:
        measure(points)


if __name__ == "__main__":
    main()
