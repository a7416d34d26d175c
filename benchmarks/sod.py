"""Sod's shock tube near the fluid limit: `python benchmarks/sod.py` (some minutes).

L1 errors against the exact Euler solution at t = 0.2, the time step set by transport alone.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests.verification.kinetic_cases import table
from tests.verification.sod import errors, tube

GRIDS = {1: ([24], 7.0), 2: ([24, 12], [7.0, 6.0]), 3: ([16, 10, 10], [7.0, 6.0, 6.0])}


def main() -> None:
    rows = []
    cases = [(d, cells, 0, 1e-5) for d in GRIDS for cells in (100, 200)]
    cases += [(3, 100, 3, 1e-5)] + [(1, 100, 0, 10.0**-k) for k in range(2, 8)]
    for d, cells, across, knudsen in cases:
        points, half_width = GRIDS[d]
        simulation, depth, limits = tube(cells, points, knudsen, across, half_width=half_width)
        assert limits <= {"transport and drift (cfl)", "end"}
        name = f"{cells}x{across}" if across else f"{cells}"
        rows.append((name, f"{d}V", knudsen, *errors(simulation), simulation.number, depth))
    table("cells velocity eps density velocity pressure steps dt*tau/eps", rows)


if __name__ == "__main__":
    main()
