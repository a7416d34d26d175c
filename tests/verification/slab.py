"""A slab of Test 5: cold gas, T = 1, between hot gas, T = 100, one space and one velocity dimension, BGK.

What the scaling costs in accuracy: against a converged run in classical variables.
"""

from __future__ import annotations

from math import pi

import numpy as np

from tests.verification.kinetic_cases import build, coarsen, es_bgk, line, run

KNUDSEN, END = 0.05, 0.1
FIELDS = ("density", "velocity", "temperature")


def slab(
    cells: int,
    points: int,
    half_width: float,
    scaling: str,
    synchronise: float | str = 0.0,
    conservative: bool = True,
    drift: str = "van-leer",
):
    """Density, velocity and temperature (cells,) at the end, and the simulation."""
    simulation = run(
        build(
            space=line(cells, "far-field", -1.0, 1.0),
            velocity={"points": [points], "half_width": half_width},
            scaling={"kind": scaling, "synchronise": synchronise},
            scheme={"conservative": conservative, "drift": drift},
            collision=es_bgk(KNUDSEN, 0.925 * pi / 2),
            initial={"state": "temperature-disc", "radius": 0.5, "inner": 1.0, "outer": 100.0},
            time={"end": END},
        )
    )
    moments = simulation.moments()
    return moments["density"][0], moments["velocity"][0, :, 0], moments["temperature"][0], simulation


def reference(cells: int = 256, points: int = 800):
    """The run in classical variables, half width 60: six thermal speeds of the hot gas."""
    return slab(cells, points, 60.0, "none")[:3]


def errors(numerical, exact) -> list[float]:
    """Relative L1 errors of density, velocity and temperature; exact is on a finer grid."""
    found = []
    for values, fine in zip(numerical, exact):
        coarse = coarsen(fine, len(values))
        found.append(float(np.sum(np.abs(values - coarse)) / np.sum(np.abs(coarse))))
    return found
