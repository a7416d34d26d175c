"""Time to solution of Test 5 against its error: `python benchmarks/test5_error.py` (some minutes on one core).

The shock of Test 5 at t = 0.05, kinetic scaling, a quarter of the square between specular planes of symmetry, on grids
of growing size: core seconds, and the errors of density and temperature against the finest grid, root mean squares
over the cells of the coarsest grid, relative to the mean. A particle method's error is that of its noise in a cell.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi import Job, Simulation
from tests.verification.kinetic_cases import table

JOB = Path(__file__).resolve().parent.parent / "jobs" / "test5_shock_kinetic.toml"
END = 0.05
SMALL, PAPER, LARGE = (16, 16, 8), (24, 24, 8), (32, 32, 8)
LIMITED, POSITIVE = "van-leer", "seventh-order-positive"
GRIDS = [
    (8, SMALL, LIMITED), (8, SMALL, POSITIVE), (16, SMALL, LIMITED), (16, SMALL, POSITIVE), (16, PAPER, LIMITED),
    (16, PAPER, POSITIVE), (24, SMALL, POSITIVE), (24, PAPER, LIMITED), (24, PAPER, POSITIVE), (32, SMALL, POSITIVE),
]  # fmt: skip
FINEST = (40, LARGE, POSITIVE)


def solve(cells: int, points: tuple[int, int, int], drift: str):
    """Density and temperature (cells, cells) at the end, the number of steps and the core seconds they took."""
    settings = [
        ("space.cells", [cells, cells]), ("space.lower", [0.0, 0.0]), ("velocity.points", list(points)),
        ("scheme.drift", f'"{drift}"'),
        ("time.end", END), ("output.times", [END]), ("output.marginals", "false"), ("fluid.enabled", "false"),
    ]  # fmt: skip
    sides = [f'space.boundary.{axis}={{lower = "specular", upper = "far-field"}}' for axis in "xy"]
    simulation = Simulation(Job.from_file(JOB, [*(f"{key}={value}" for key, value in settings), *sides]))
    begin = time.process_time()
    for _ in simulation:
        pass
    seconds = time.process_time() - begin
    moments = simulation.moments()
    return (moments["density"], moments["temperature"]), simulation.number, seconds


def coarsen(values: np.ndarray, cells: int) -> np.ndarray:
    """Means over squares of cells."""
    times = len(values) // cells
    return values.reshape(cells, times, cells, times).mean(axis=(1, 3))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    coarsest = min(cells for cells, *_ in GRIDS)
    exact = [coarsen(values, coarsest) for values in solve(*FINEST)[0]]
    rows = []
    for cells, points, drift in GRIDS:
        found, steps, seconds = solve(cells, points, drift)
        errors = [
            float(np.sqrt(np.mean((coarsen(values, coarsest) - fine) ** 2)) / fine.mean())
            for values, fine in zip(found, exact)
        ]
        rows.append((f"{cells}x{cells}", "x".join(map(str, points)), drift, steps, seconds, *errors))
        print(f"{rows[-1]}", file=sys.stderr, flush=True)
    table("cells velocities drift steps core_seconds density temperature", rows)


if __name__ == "__main__":
    main()
