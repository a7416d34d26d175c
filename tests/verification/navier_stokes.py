"""Viscosity and thermal conductivity from decaying waves at small Knudsen number, in the velocity dimensions given.

A shear wave of transverse velocity decays at the rate mu k^2/rho; an isobaric wave of density and temperature at
kappa k^2/(rho c_p), c_p = (d + 2)/2. For ES-BGK with tau/eps = 1/lambda at unit density: mu = Pr p lambda and
kappa = c_p p lambda, so the rates are Pr lambda k^2 and lambda k^2 at unit pressure.
"""

from __future__ import annotations

import numpy as np

from rvm_mpi import Simulation
from tests.verification.kinetic_cases import build, es_bgk, line

K = 2 * np.pi
AMPLITUDE = 0.01


def _decay(relaxation_time, cells, points, scaling, drift, prandtl, half_width, times, initial, signal):
    """Mean decay rate of a signal between two times."""
    simulation = Simulation(
        build(
            space=line(cells),
            velocity={"points": list(points), "half_width": half_width},
            scaling=scaling,
            scheme={"drift": drift},
            collision=es_bgk(relaxation_time, prandtl=prandtl),
            initial={"state": "uniform"},
            time={"end": times[1]},
            output={"times": list(times)},
        ),
        initial,
    )
    found = {}
    for step in simulation:
        if step.time in times:
            found[step.time] = signal(simulation.moments())
    return float(np.log(found[times[0]] / found[times[1]]) / (times[1] - times[0]))


def _amplitude(values: np.ndarray) -> float:
    """Amplitude of cos(k x) in values at the cell centres."""
    x = (np.arange(values.size) + 0.5) / values.size
    return float(2 * np.mean(values * np.cos(K * x)))


def viscosity(
    relaxation_time=0.01, cells=32, points=(12, 12, 12), scaling="kinetic", drift="van-leer", prandtl=2 / 3,
    half_width=6.0,
):  # fmt: skip
    """mu/(p relaxation_time) of a decaying shear wave; Chapman and Enskog: Pr."""

    def initial(x, y):
        shear = AMPLITUDE * np.cos(K * x)[..., None] * np.eye(len(points))[1]
        return 1.0 + 0.0 * x, shear, 1.0

    rate = _decay(
        relaxation_time, cells, points, scaling, drift, prandtl, half_width, (0.1, 0.5), initial,
        lambda moments: _amplitude(moments["velocity"][0, :, 1]),
    )  # fmt: skip
    return rate / (relaxation_time * K**2)


def conductivity(
    relaxation_time=0.01, cells=32, points=(12, 12, 12), scaling="kinetic", drift="van-leer", prandtl=2 / 3,
    half_width=6.0,
):  # fmt: skip
    """kappa/(5/2 p relaxation_time) of a decaying isobaric wave; Chapman and Enskog: 1.

    The start is not the pure mode and sends off sound of relative amplitude lambda k. Sound carries no entropy to this
    order, so the entropy perturbation is what is measured, over one period of the sound.
    """

    d = len(points)

    def initial(x, y):
        temperature = 1.0 + AMPLITUDE * np.cos(K * x)
        return 1.0 / temperature, np.zeros(d), temperature

    def entropy(moments):
        return _amplitude(np.log(moments["temperature"][0]) - 2 / d * np.log(moments["density"][0]))

    period = 1.0 / np.sqrt((d + 2) / d)
    rate = _decay(
        relaxation_time, cells, points, scaling, drift, prandtl, half_width, (0.1, 0.1 + period), initial, entropy
    )  # fmt: skip
    return rate / (relaxation_time * K**2)
