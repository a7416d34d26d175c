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
from rvm_mpi.step.data import lay_out, work_space
from rvm_mpi.step.sweep import mix

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
def repeat(grid, work, out, watched):
    for _ in range(REPEATED):
        mix(grid, work, 1.0, 0.5, out, 0, watched)


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
    out, work = aligned((grid.block,)), lay_out.py_func(grid, 1, work_space(grid, 1))[0]
    work.result[:], work.gaussian.block[:] = np.random.default_rng(1).random((2, grid.block))
    work.correction.factor_x[:], work.correction.factor_slab[:] = 1.0, 1.0
    on, off = best_of(200, lambda: repeat(grid, work, out, True), lambda: repeat(grid, work, out, False))
    extra = (on - off) / (REPEATED * nodes)
    step = best_of(20, simulation.advance)[0] / (nodes * 144)
    print(f"the kernel: {1e9 * extra:.3f} ns a node more when watched")
    print(f"a whole step: {1e9 * step:.2f} ns a node; one of its two stages is watched: {100 * extra / step:.2f} %")


if __name__ == "__main__":
    main()
