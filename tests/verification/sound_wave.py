"""A sound wave in a gas that relaxes by ES-BGK, 1D/3V, and the exact solution of the linearised equation.

With f = M (1 + delta h e^(ikx)), M a Maxwellian of unit density and temperature at rest, what matters of h is
a(v) = int h M dv_perp and b(v) = int (|v_perp|^2/2 - 1) h M dv_perp, v along the wave:

    d_t a + i k v a = r (M [rho + u v + lambda (v^2 - 1)/2] - a),     d_t b + i k v b = r (M lambda_perp - b)

with lambda = (1 - nu) T + nu theta along the wave, lambda_perp across. Gauss and Hermite's nodes in v, and the
exponential of a matrix.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from rvm_mpi import Simulation
from tests.verification.kinetic_cases import build, es_bgk, line

K = 2.0 * np.pi


def exact(relaxation_time: float, prandtl: float, start: tuple[complex, complex, complex], time: float) -> np.ndarray:
    """Complex amplitudes of density, velocity and temperature at a time; `start` are those at the beginning."""
    v, weight = np.polynomial.hermite_e.hermegauss(80)
    weight = weight / weight.sum()
    n, zero = v.size, np.zeros(v.size)
    nu = 1.0 - 1.0 / prandtl
    # rows: what a moment is of (a, b), both over the weights M
    density, velocity = np.r_[weight, zero], np.r_[weight * v, zero]
    along, across = np.r_[weight * (v**2 - 1.0), zero], np.r_[zero, weight]
    temperature = (along + 2.0 * across) / 3.0
    gained_a = np.outer(np.ones(n), density) + np.outer(v, velocity)
    gained_a += np.outer(0.5 * (v**2 - 1.0), (1.0 - nu) * temperature + nu * along)
    gained_b = np.outer(np.ones(n), (1.0 - nu) * temperature + nu * across)
    rate = (np.vstack([gained_a, gained_b]) - np.eye(2 * n)) / relaxation_time - 1j * K * np.diag(np.r_[v, v])
    rho, u, t = start
    begin = np.r_[rho + u * v + 0.5 * t * (v**2 - 1.0), t * np.ones(n)]
    end = expm(rate * time) @ begin
    return np.array([density @ end, velocity @ end, temperature @ end])


def errors(
    drift: str, points=(24, 12, 8), cells: int = 64, relaxation_time: float = 0.02, half_width: float = 7.0,
    time: float = 0.7, amplitude: float = 1e-3,
) -> np.ndarray:  # fmt: skip
    """Errors of density, velocity and temperature at the end, of the mode the wave has, over its first amplitude."""
    prandtl = 2.0 / 3.0
    # the wave that goes up in an ideal gas
    start = (1.0, np.sqrt(5.0 / 3.0), 2.0 / 3.0)

    def initial(x, y):
        wave = amplitude * np.cos(K * x)
        velocity = start[1] * wave[..., None] * np.eye(3)[0]
        return 1.0 + start[0] * wave, velocity, 1.0 + start[2] * wave

    simulation = Simulation(
        build(
            space=line(cells),
            velocity={"points": list(points), "half_width": half_width},
            scheme={"drift": drift},
            collision=es_bgk(relaxation_time, prandtl=prandtl),
            initial={"state": "uniform"},
            time={"end": time},
        ),
        initial,
    )
    for _ in simulation:
        pass
    moments = simulation.moments()
    fields = moments["density"][0] - 1.0, moments["velocity"][0, :, 0], moments["temperature"][0] - 1.0
    x = (np.arange(cells) + 0.5) / cells
    found = [2.0 * np.mean(values * np.exp(-1j * K * x)) / amplitude for values in fields]
    return np.abs(np.array(found) - exact(relaxation_time, prandtl, start, time))
