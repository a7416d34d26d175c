"""Sod's shock tube near the fluid limit, dt set by transport alone."""

from __future__ import annotations

import numpy as np

from rvm_mpi import Simulation
from tests.verification.euler_exact import cell_averages, gamma_of
from tests.verification.kinetic_cases import build, es_bgk

END = 0.2
LEFT, RIGHT = (1.0, 1.0), (0.125, 0.8)  # density, temperature: pressure 1 and 0.1


def tube(cells: int, points, knudsen: float, rows: int = 0, scaling: str = "kinetic", end: float = END, half_width=7.0):
    """The tube over [0, 1], in one dimension or with `rows` cells of the same width in y.

    Returns the simulation, the smallest depth dt tau/eps in the dense gas, and the names of the limits that set dt.
    """
    space = {"cells": [cells], "lower": [0.0], "upper": [1.0], "boundary": {"x": "outflow"}}
    if rows:
        space = {
            "cells": [cells, rows],
            "lower": [0.0, 0.0],
            "upper": [1.0, rows / cells],
            "boundary": {"x": "outflow", "y": "periodic"},
        }
    simulation = Simulation(
        build(
            space=space,
            velocity={"points": list(points), "half_width": half_width},
            scaling=scaling,
            collision=es_bgk(knudsen),
            initial={
                "state": "riemann",
                "left": {"density": LEFT[0], "temperature": LEFT[1]},
                "right": {"density": RIGHT[0], "temperature": RIGHT[1]},
            },
            time={"end": end},
        )
    )
    depth, limits = np.inf, set()
    for step in simulation:
        limits.add(step.limit)
        if step.limit != "end":
            depth = min(depth, step.dt * LEFT[0] / knudsen)
    return simulation, depth, limits


def errors(simulation) -> list[float]:
    """L1 errors of density, velocity and pressure against the exact solution of the Euler equations."""
    job = simulation.job
    cells, d = job.space.cells[0], job.velocity.dimensions
    left, right = ((rho, 0.0, rho * temperature) for rho, temperature in (LEFT, RIGHT))
    exact = cell_averages(left, right, job.time.end, np.linspace(0, 1, cells + 1), 0.5, gamma_of(d))
    moments = simulation.moments()
    density, velocity, temperature = moments["density"], moments["velocity"][..., 0], moments["temperature"]
    return [
        float(np.mean(np.abs(a - b))) for a, b in zip((density, velocity, density * temperature), exact)
    ]
