"""Homogeneous cooling states of hard spheres, d = 2 and 3: a_2 and Haff's law against Sonine theory.

`python benchmarks/cooling_states.py` (some minutes): first the operator itself, then whole runs; `--large` for more
points in d = 3 (half an hour), `--grid 3 24 7.5` for the operator on one grid. `dsmc.py` has the same numbers from
particles.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests.verification.cooling_state import cool, cooling_state, stationary, van_noije_ernst

RESTITUTIONS = (0.5, 0.7, 0.8, 0.9)
DRIFTS = ("van-leer", "maxwellian", "seventh-order")


def operator(grids):
    print("the operator itself: d, points, V, e, a_2, rate of cooling over a Gaussian's")
    for d, points, half_width in grids:
        for e in RESTITUTIONS:
            try:
                a, factor = stationary(d, e, points, half_width)
                print(f"{d} {points} {half_width} {e} {a:9.5f} {factor:.5f}", flush=True)
            except ArithmeticError as error:
                print(f"{d} {points} {half_width} {e} {error}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--large", action="store_true", help="24 and 28 points a direction in d = 3, too")
    parser.add_argument("--only", choices=("theory", "operator", "runs"))
    parser.add_argument("--grid", nargs=3, metavar=("D", "POINTS", "V"), help="the operator on this grid alone")
    given = parser.parse_args()
    if given.grid:
        d, points, half_width = given.grid
        operator([(int(d), int(points), float(half_width))])
        return
    if given.only in (None, "theory"):
        print(
            " d    e  van Noije, Ernst   linear  orders 2, 4, 6, 7, 8; rate of cooling over a Gaussian's, linear and 8"
        )
        for d in (2, 3):
            for e in RESTITUTIONS:
                (a,), linear = cooling_state(d, e, 2, True)
                found = [cooling_state(d, e, order) for order in (2, 4, 6, 7, 8)]
                print(f"{d:2} {e:4} {van_noije_ernst(d, e):17.5f} {a:8.5f} " + "".join(f"{f[0][0]:9.5f}" for f in found)
                      + f"  {linear:.5f} {found[-1][1]:.5f}")  # fmt: skip
    if given.only in (None, "operator"):
        grids = [(2, 32, 9.0), (2, 48, 10.0), (3, 16, 6.0), (3, 16, 7.0), (3, 20, 7.0)]
        operator(grids + [(3, 24, 7.5), (3, 24, 8.5), (3, 28, 8.0)] * given.large)
    if given.only in (None, "runs"):
        print("whole runs over four decades: d, points, V, drift, e, a_2, T over Haff's with the rate of order 8,")
        print("departure of log T from the law over the second half of the steps, steps")
        cases = [(2, points, half_width, drift) for points, half_width in ((32, 9.0), (48, 10.0)) for drift in DRIFTS]
        for d, points, half_width, drift in cases + [(3, 24, 8.5, "seventh-order")] * given.large:
            for e in RESTITUTIONS:
                factor = cooling_state(d, e, 8)[1]
                a, ratio, bend, steps = cool(d, e, points, half_width, drift, factor)
                print(f"{d} {points} {half_width} {drift} {e} {a:.5f} {ratio:.5f} {bend:.5f} {steps}", flush=True)


if __name__ == "__main__":
    main()
