"""What the drift in substeps saves, at what error: `python benchmarks/time_step.py` (minutes on one core).

Tests 4 and 5 on small grids, kinetic and macroscopic scaling: steps, seconds and relative L1 errors of density and
temperature, with the drift in substeps and with steps short enough that it needs none, for some values of `cfl`. The
errors in time are those against the shortest steps without substeps on the same grid; the error of the grid, beside
which they are to be seen, is that of the same run against one on twice the cells.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi import Job, Simulation, time_limits
from tests.verification.kinetic_cases import table

ROOT = Path(__file__).resolve().parent.parent
CASES = {
    "test5_shock_kinetic": (24, [16, 16, 8], 0.02),
    "test4_clustering_kinetic": (24, [16, 16, 8], 0.5),
    "test5_shock": (24, [16, 16, 8], 0.02),
    "test4_clustering": (24, [16, 16, 8], 0.2),
}


def solve(name: str, cells: int, cfl: float, substeps: bool):
    """Density and temperature (cells, cells) at the end, the number of steps and the seconds of a core they took."""
    _, points, end = CASES[name]
    settings = [
        ("space.cells", [cells, cells]), ("velocity.points", points), ("time.end", end), ("time.cfl", cfl),
        ("output.times", [end]), ("output.marginals", False),
    ]  # fmt: skip
    job = Job.from_file(ROOT / "jobs" / f"{name}.toml", [f"{key}={str(value).lower()}" for key, value in settings])
    shares = time_limits.DRIFT_SHARES
    if not substeps:
        time_limits.DRIFT_SHARES = (1.0,)
    simulation = Simulation(job)
    begin = time.process_time()
    for _ in simulation:
        pass
    seconds = time.process_time() - begin
    time_limits.DRIFT_SHARES = shares
    moments = simulation.moments()
    return (moments["density"], moments["temperature"]), simulation.number, seconds


def errors(found, exact) -> list[float]:
    """Relative L1 distances; exact is on the same grid or on one of twice the cells."""
    result = []
    for values, fine in zip(found, exact):
        n, times = len(values), len(fine) // len(values)
        coarse = fine.reshape(n, times, n, times).mean(axis=(1, 3))
        result.append(float(np.abs(values - coarse).sum() / np.abs(coarse).sum()))
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("jobs", nargs="*", default=list(CASES), help="of " + ", ".join(CASES))
    parser.add_argument("--finest", type=float, default=0.05, help="cfl of the reference")
    options = parser.parse_args()
    for name in options.jobs:
        cells = CASES[name][0]
        exact, steps, seconds = solve(name, cells, options.finest, False)
        rows = [("no substeps", options.finest, steps, seconds, 0.0, 0.0)]
        for substeps in (False, True):
            for cfl in (0.5, 0.25, 0.125):
                found, steps, seconds = solve(name, cells, cfl, substeps)
                rows.append(("substeps" if substeps else "no substeps", cfl, steps, seconds, *errors(found, exact)))
        # white noise is another state on other cells
        if "test5" in name:
            fine = solve(name, 2 * cells, 0.5, True)[0]
            rows.append(("the grid's own error", 0.5, 0, 0.0, *errors(exact, fine)))
        print(f"{name}, {cells} x {cells} cells")
        table("drift cfl steps seconds density temperature", rows)


if __name__ == "__main__":
    main()
