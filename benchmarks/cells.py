"""The error of the cells: `python benchmarks/cells.py` (about two minutes).

L1 errors of density, velocity and temperature of a wave in free transport, 64 velocities, against the exact solution,
and, relative, of the slab of Test 5, 24 velocities, against the same on 512 cells.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests.verification import free_transport
from tests.verification.kinetic_cases import table
from tests.verification.slab import errors, slab

FINEST = 512


def main() -> None:
    rows = []
    for scaling, drift in (("none", "van-leer"), ("kinetic", "seventh-order")):
        for cells in (16, 32, 64, 128):
            found, simulation = free_transport.errors(cells, 64, scaling, drift=drift)
            rows.append((f"wave,{scaling}", cells, *found, simulation.number))
    *finest, _simulation = slab(FINEST, 24, 7.0, "kinetic", drift="seventh-order-positive")
    for cells in (16, 32, 64, 128):
        *numerical, simulation = slab(cells, 24, 7.0, "kinetic", drift="seventh-order-positive")
        rows.append(("slab,kinetic", cells, *errors(numerical, finest), simulation.number))
    table("case cells density velocity temperature steps", rows)


if __name__ == "__main__":
    main()
