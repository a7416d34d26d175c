"""The order of the time scheme with space: a smooth wave on a fixed grid, the step length varied."""

from __future__ import annotations

import numpy as np

from tests.verification.kinetic_cases import build, es_bgk, fixed_steps, line

FIELDS = ("density", "temperature", "heat_flux")


def wave_job(dt: float, end: float, knudsen: float, cells: int, points: list[int], scaling: str, drift: str):
    """A wave of density, temperature and velocity; tau/eps = rho/knudsen."""
    d = len(points)
    return build(
        space=line(cells),
        velocity={"points": points, "half_width": 6.0},
        scaling=scaling,
        scheme={"drift": drift},
        collision=es_bgk(knudsen),
        initial={
            "state": "wave",
            "velocity": [0.3, 0.0, 0.0][:d],
            "density_amplitude": 0.2,
            "temperature_amplitude": -0.15,
            "velocity_amplitude": [0.1, 0.1, 0.0][:d],
        },
        time={"end": end, "dt": dt},
    )


def errors(
    knudsen_of_dt, steps, finest, end=0.07, cells=32, points=(24,), scaling="kinetic", drift="van-leer"
) -> list[list[float]]:
    """L1 distances (len(steps), 3) of `FIELDS` from a run of `finest` steps at the same Knudsen number."""
    rows, finest_runs = [], {}
    for n in steps:
        knudsen = knudsen_of_dt(end / n)

        def job(dt: float, knudsen: float = knudsen):
            return wave_job(dt, end, knudsen, cells, list(points), scaling, drift)

        if knudsen not in finest_runs:
            finest_runs[knudsen] = fixed_steps(job, end, finest).moments()
        coarse, fine = fixed_steps(job, end, n).moments(), finest_runs[knudsen]
        rows.append([float(np.mean(np.abs(coarse[name] - fine[name]))) for name in FIELDS])
    return rows
