"""The slab of Test 5 against a converged run in classical variables: `python benchmarks/slab.py` (about two minutes).

Relative L1 errors of density, velocity and temperature at t = 0.1 on 64 cells; the reference has 256 cells, 800
velocities, half width 60.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi.step.failure import NumericalFailure
from tests.verification.kinetic_cases import table
from tests.verification.slab import errors, reference, slab

CASES = [
    ("macroscopic", "macroscopic", 0.0, False),
    ("macroscopic,conservative", "macroscopic", 0.0, True),
    ("macroscopic,synchronise=200", "macroscopic", 200.0, False),
    ("macroscopic,synchronise=auto", "macroscopic", "auto", False),
    ("kinetic", "kinetic", 0.0, True),
]


def main() -> None:
    exact = reference()
    check = errors(reference(128, 400), exact)
    rows = [("none,V=60,128cells", 400, *check, 0, 0.0, 0.0)]
    for name, scaling, synchronise, conservative in CASES:
        for points in (24, 48, 96):
            try:
                *numerical, simulation = slab(64, points, 7.0, scaling, synchronise, conservative)
            except NumericalFailure as failure:
                print(f"{name}, {points} velocities: {failure}", flush=True)
                continue
            row = simulation.diagnostics.row
            watched = row["energy_error"], row["box_energy"]
            rows.append((name, points, *errors(numerical, exact), simulation.number, *watched))
    table("scaling velocities density velocity temperature steps energy_error box_energy", rows)


if __name__ == "__main__":
    main()
