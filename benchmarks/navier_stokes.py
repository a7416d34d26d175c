"""Viscosity, conductivity and Prandtl number of ES-BGK: `python benchmarks/navier_stokes.py` (some minutes).

mu tau/(p eps) and kappa tau/(5/2 p eps) from decaying waves at tau/eps = 100, on 64 cells; Chapman and Enskog say 2/3
and 1. A temperature gradient is one of omega: in rescaled velocities the drift's error is one of the conductivity.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests.verification.kinetic_cases import table
from tests.verification.navier_stokes import conductivity, viscosity


def main() -> None:
    rows = []
    for scaling, drift, points in (
        ("none", "van-leer", (12, 12, 12)),
        ("kinetic", "van-leer", (12, 12, 12)),
        ("kinetic", "van-leer", (24, 12, 12)),
        ("kinetic", "maxwellian", (12, 12, 12)),
        ("kinetic", "maxwellian", (24, 12, 12)),
        ("kinetic", "seventh-order", (12, 12, 12)),
        ("kinetic", "seventh-order", (24, 12, 12)),
    ):
        mu, kappa = (f(0.01, 64, points, scaling, drift) for f in (viscosity, conductivity))
        rows.append((scaling, drift, "x".join(map(str, points)), mu, kappa, mu / kappa))
    table("scaling drift velocities viscosity conductivity Prandtl", rows)
    drifts = ("van-leer", "maxwellian", "seventh-order")
    cases = (("none", "van-leer"), *(("kinetic", drift) for drift in drifts))
    rows = []
    for n in (12, 24, 48, 96, 192):
        rows.append((n, *(conductivity(0.02, 32, (n,), *case, 1.0) for case in cases)))
    print("one velocity dimension, tau/eps = 50, 32 cells: conductivity")
    table("velocities none kinetic,van-leer kinetic,maxwellian kinetic,seventh-order", rows)


if __name__ == "__main__":
    main()
