"""What it costs to watch the outermost velocities: `python benchmarks/watch_cost.py` (half a minute).

The same stage on 12 x 12 cells of 24 x 24 x 8 velocities with and without: a stage of no length is watched, one of
length 1e-30 is not and does the same otherwise; without collisions, which would hide it. Best of many, by turns, on
one core.
"""

import sys
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi import Job, Simulation

JOB = {
    "space": {"cells": [12, 12]},
    "velocity": {"points": [24, 24, 8]},
    "collision": {"operator": "none"},
    "initial": {"state": "random-density", "low": 0.5},
    "time": {"end": 1.0},
}
LENGTHS = {"watched": 0.0, "not watched": 1e-30}


def main() -> None:
    kinetic = Simulation(Job.from_dict(JOB)).kinetic
    best = dict.fromkeys(LENGTHS, float("inf"))
    for _ in range(300):
        for name, dt in LENGTHS.items():
            begin = perf_counter()
            kinetic.first_stage(dt)
            best[name] = min(best[name], perf_counter() - begin)
    for name, seconds in best.items():
        print(f"{name}: {1e3 * seconds:.3f} ms a stage")
    extra = best["watched"] - best["not watched"]
    print(f"one of the two stages of a step is watched: {50 * extra / best['not watched']:.2f} % of a step")


if __name__ == "__main__":
    main()
