"""The time of a stage with each reconstruction of the drift over that with Van Leer's, one core.

Stages are taken in turn, the least processor time of six counts; the gas is Test 4's, no cell takes substeps.

    python benchmarks/drift_cost.py
"""

import time
from pathlib import Path

from rvm_mpi import Job, Simulation
from rvm_mpi.kinetic.drift import RECONSTRUCTIONS

JOB = Path(__file__).resolve().parent.parent / "jobs" / "test4_clustering_kinetic.toml"
GRIDS = {(24, 24, 8): 32, (16, 16, 16): 32, (24, 24, 24): 20, (32, 32, 32): 16}
ROUNDS = 6


def main() -> None:
    names = sorted(RECONSTRUCTIONS, key=lambda name: name != "van-leer")
    print("| velocities | " + " | ".join(names[1:]) + " |\n" + "| --- " * len(names) + "|")
    for points, cells in GRIDS.items():
        steppers = {}
        for name in names:
            changes = [f"space.cells=[{cells}, {cells}]", f"velocity.points={list(points)}", f'scheme.drift="{name}"']
            steppers[name] = Simulation(Job.from_file(JOB, changes)).kinetic
        times = dict.fromkeys(names, float("inf"))
        for _ in range(ROUNDS):
            for name, kinetic in steppers.items():
                dt = 0.45 / kinetic.rates[0]
                begin = time.process_time()
                kinetic.first_stage(dt)
                kinetic.later_stages(dt)
                times[name] = min(times[name], time.process_time() - begin)
        ratios = " | ".join(f"{times[name] / times['van-leer']:.2f}" for name in names[1:])
        print(f"| {'x'.join(map(str, points))} | {ratios} |", flush=True)


if __name__ == "__main__":
    main()
