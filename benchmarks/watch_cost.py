"""What it costs to watch the outermost velocities: `python benchmarks/watch_cost.py` (half a minute).

The kernel that ends a stage, with and without, on one block of 24 x 24 x 8 velocities in cache, beside a whole step of
12 x 12 cells. Best of many, by turns, on one core.
"""

import sys
from pathlib import Path
from time import process_time

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from numba import njit

from rvm_mpi import Job, Simulation
from rvm_mpi.grid.domain import aligned
from rvm_mpi.step import sweep as stage

POINTS = [24, 24, 8]
JOB = {
    "space": {"cells": [12, 12]},
    "velocity": {"points": POINTS},
    "collision": {"operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.9},
    "fluid": {"enabled": True},
    "initial": {"state": "random-density", "low": 0.5},
    "time": {"end": 1.0},
}
REPEATED = 100


@njit
def repeat(grid, block, ones_x, ones_slab, gaussian, out, watched, extremes):
    for _ in range(REPEATED):
        stage.mix(
            block, ones_x, ones_slab, 1.0, gaussian, 0.5, grid.points[0], grid.slab_size, grid.x, grid.slab, out, 0,
            watched, extremes,
        )  # fmt: skip


def best_of(times: int, *actions) -> list[float]:
    """Seconds of processor time of each action."""
    best = [float("inf")] * len(actions)
    for _ in range(times):
        for k, action in enumerate(actions):
            begin = process_time()
            action()
            best[k] = min(best[k], process_time() - begin)
    return best


def main() -> None:
    simulation = Simulation(Job.from_dict(JOB))
    grid, nodes = simulation.kinetic.grid, np.prod(POINTS)
    block, gaussian, out = (aligned((grid.block,)) for _ in range(3))
    block[:], gaussian[:] = np.random.default_rng(1).random((2, grid.block))
    given = (grid, block, np.ones(POINTS[0]), np.ones(grid.slab_size), gaussian, out)
    extremes = np.zeros(16)
    on, off = best_of(200, lambda: repeat(*given, True, extremes), lambda: repeat(*given, False, extremes))
    extra = (on - off) / (REPEATED * nodes)
    step = best_of(20, simulation.advance)[0] / (nodes * 144)
    print(f"the kernel: {1e9 * extra:.3f} ns a node more when watched")
    print(f"a whole step: {1e9 * step:.2f} ns a node; one of its two stages is watched: {100 * extra / step:.2f} %")


if __name__ == "__main__":
    main()
