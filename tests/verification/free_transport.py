"""Free transport of a smooth wave: no collisions, the exact density is an integral over the start."""

from __future__ import annotations

import numpy as np

from tests.verification.kinetic_cases import build, line, run

WAVE = {
    "state": "wave",
    "density": 1.0,
    "density_amplitude": 0.3,
    "temperature": 1.0,
    "temperature_amplitude": 0.2,
    "velocity": [0.5],
    "velocity_amplitude": [0.2],
}


def exact(x, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Density, velocity and temperature at x: moments of f0(x - v t, v) by the trapezoidal rule in v."""
    v = np.linspace(-11.0, 11.0, 4001)
    shape = np.cos(2 * np.pi * (np.asarray(x)[:, None] - v * time))
    rho, u, temperature = 1 + 0.3 * shape, 0.5 + 0.2 * shape, 1 + 0.2 * shape
    f = rho / np.sqrt(2 * np.pi * temperature) * np.exp(-((v - u) ** 2) / (2 * temperature)) * (v[1] - v[0])
    density, momentum, energy = f.sum(1), (f * v).sum(1), (f * v * v).sum(1)
    velocity = momentum / density
    return density, velocity, energy / density - velocity**2


def errors(cells: int, points: int, scaling: str, conservative: bool = True, drift: str = "van-leer", end: float = 0.1):
    """L1 errors of density, velocity and temperature at the end, and the simulation."""
    simulation = run(
        build(
            space=line(cells),
            velocity={"points": [points], "half_width": 7.0},
            scaling=scaling,
            scheme={"conservative": conservative, "drift": drift},
            collision={"operator": "none"},
            initial=WAVE,
            time={"end": end},
        )
    )
    moments = simulation.moments()
    numerical = (moments["density"][0], moments["velocity"][0, :, 0], moments["temperature"][0])
    truth = exact((np.arange(cells) + 0.5) / cells, end)
    return [float(np.mean(np.abs(a - b))) for a, b in zip(numerical, truth)], simulation
