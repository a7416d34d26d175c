"""How far two rescaled runs of Test 1 agree: temperature and the first marginal of f, at the stored times.

`jobs/test1.sh` makes the runs; `python benchmarks/test1_agreement.py runs/test1_coupled_96 runs/test1_macroscopic_96`.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi.results import open_run


def marginal(run, index, v):
    """First marginal of f at velocities v: g's over omega, between its nodes by cubic splines."""
    omega = float(run.scaling_omega[index])
    return CubicSpline(omega * run.xi_x.values, run.marginal_x.values[index] / omega, extrapolate=False)(v)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("directories", metavar="DIR", nargs=2, type=Path)
    one, other = (open_run(directory) for directory in parser.parse_args().directories)
    if not np.array_equal(one.time, other.time):
        raise SystemExit("the runs have not the same stored times")
    print("     t  temperatures             relative difference  marginals of f, relative L1 within 5 thermal speeds")
    for index, time in enumerate(one.time.values):
        temperatures = [float(run.kinetic_temperature[index]) for run in (one, other)]
        v = np.linspace(-5, 5, 4001) * temperatures[1] ** 0.5
        first, second = (marginal(run, index, v) for run in (one, other))
        distance = np.abs(first - second).sum() / np.abs(second).sum()
        change = temperatures[0] / temperatures[1] - 1
        print(f"{time:6g}  {temperatures[0]:.5e} {temperatures[1]:.5e}  {change:19.1e}  {distance:.1e}")


if __name__ == "__main__":
    main()
