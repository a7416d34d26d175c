"""Cost of one evaluation of the direct Boltzmann operator beside the processor's arithmetic: seconds to run.

`python benchmarks/boltzmann.py`, with `--large` for 24 and 32 points a direction in d = 3 (about ten seconds more).

A pair of modes needs 10 operations on complex numbers with a real weight, in two multiplications and four fused
multiply-adds, so a sum that is limited by nothing but arithmetic reaches 10/12 of the peak of fused multiply-adds.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi.collisions.boltzmann import BoltzmannOperator, add_pairs
from rvm_mpi.kernels import kernel
from rvm_mpi.simd import splat, store

OPERATIONS = 10
GRIDS = [(n,) * d for d, sizes in ((1, (16, 32, 64)), (2, (16, 32, 64)), (3, (8, 12, 16))) for n in sizes]
LARGE = [(24,) * 3, (32,) * 3]


@kernel
def multiply_add(count, out):
    """10 independent chains of fused multiply-adds of eight doubles."""
    x, y = splat(0.999999), splat(1e-7)
    a, b, c, d, e = splat(1.0), splat(2.0), splat(3.0), splat(4.0), splat(5.0)
    f, g, h, i, j = splat(6.0), splat(7.0), splat(8.0), splat(9.0), splat(10.0)
    for _ in range(count):
        a, b, c, d, e = a * x + y, b * x + y, c * x + y, d * x + y, e * x + y
        f, g, h, i, j = f * x + y, g * x + y, h * x + y, i * x + y, j * x + y
    store(out, 0, a + b + c + d + e + f + g + h + i + j)


def best(function, repeats=5):
    """Least processor seconds of a call, after one to compile: other work on the machine counts little."""
    function()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        function()
        times.append(time.thread_time() - start)
    return min(times)


def measure(points, peak):
    start = time.thread_time()
    operator = BoltzmannOperator.create(points, 8.0, restitution=0.9)
    made = time.thread_time() - start
    cells = int(min(4096, max(8, 8 * (2e7 // (8 * operator.rows.products + 1)))))
    g = np.random.default_rng(1).random((cells, *points))
    out = np.empty_like(g)
    seconds = best(lambda: operator.collide(g, out)) / cells
    work, rows = operator._work, operator.rows
    sizes = rows.pairs, work["kind"], rows.offsets, operator.weights, rows.modes[2]
    kernel = best(lambda: add_pairs(*sizes, *work["modes"]))
    rate, inner = (OPERATIONS * rows.products / s for s in (seconds, kernel / 8))
    print(
        f"{' x '.join(map(str, points)):>13} {rows.products:>11} {operator.nbytes / 1e6:>9.2f} {made:>8.2f}"
        f" {seconds * 1e6:>11.2f} {rate / 1e9:>7.1f} {rate / peak:>6.0%} {inner / peak:>6.0%}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--large", action="store_true", help="24 and 32 points a direction in d = 3, too")
    large = parser.parse_args().large
    out = np.empty(8)
    peak = 1e6 * 160 / best(lambda: multiply_add(1_000_000, out))
    print(f"fused multiply-adds, one core: {peak / 1e9:.1f} GFlop/s")
    print("       points       pairs   weights   making        cell   speed  of the peak")
    print("                                MB        s          us  GFlop/s   all    sum")
    for points in GRIDS + LARGE * large:
        measure(points, peak)


if __name__ == "__main__":
    main()
