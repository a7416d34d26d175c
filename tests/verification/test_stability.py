"""The critical wavelength of a cooling gas: shear waves of a granular gas below and above it."""

import numpy as np
import pytest

from rvm_mpi import Simulation, kinetic_theory
from rvm_mpi.advice import stability
from tests.verification.kinetic_cases import build

RESTITUTION = 0.95


def wave(knudsen, end=1.0):
    """A shear wave in a box of length one."""
    return build(
        space={"cells": [20]},
        velocity={"points": [12, 12], "half_width": 5.5},
        scheme={"drift": "seventh-order"},
        collision={"operator": "granular-es-bgk", "knudsen": knudsen, "restitution": RESTITUTION},
        initial={"state": "wave", "velocity_amplitude": [0.0, 0.01]},
        time={"end": end},
    )


def gas_of(job):
    return stability.CoolingGas.create(job.collision, job.velocity.dimensions, 1.0, 1.0)


def growth_per_cooling(job):
    """(d ln(u/sqrt T)/dt)/zeta of the wave, over the second half of the run: by how much T falls."""
    simulation = Simulation(job)
    x = 2 * np.pi * (np.arange(20) + 0.5) / 20
    sizes, falls = [], []
    for step in simulation:
        if step.time < 0.5 * job.time.end:
            continue
        moments = simulation.moments()
        temperature = moments["temperature"].mean()
        sizes.append(np.log(2 * np.mean(moments["velocity"][0, :, 1] * np.cos(x)) / np.sqrt(temperature)))
        falls.append(-np.log(temperature))
    return float(np.polyfit(falls, sizes, 1)[0])


def test_shear_waves_decay_below_the_critical_wavelength_and_grow_above():
    """Growth over cooling rate is 1/2 (1 - (critical length/box)^2), straight in 1/box^2: where it is nought agrees."""
    critical = gas_of(wave(1.0)).shear_wavelength  # grows as the Knudsen number
    boxes = np.array([0.8, 1.25])
    found = np.array([growth_per_cooling(wave(1 / (critical * box))) for box in boxes])
    expected = 0.5 * (1 - 1 / boxes**2)
    nought = np.interp(0.0, found, -1 / boxes**2)  # straight in 1/box^2
    print(f"growth over cooling rate {found}, theory {expected}; critical box {(-nought) ** -0.5:.4f} of the theory's")
    assert found[0] < -0.1 and found[1] > 0.1
    # eighty cells: -0.2312 and 0.1898; the Knudsen numbers are 0.29 and 0.19, and theory is of small ones
    np.testing.assert_allclose(found, [-0.2312, 0.1898], atol=0.01)
    np.testing.assert_allclose(found, expected, atol=0.06)
    assert (-nought) ** -0.5 == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("restitution", [0.7, 0.9, 0.99])
def test_the_modes_turn_at_the_critical_wavelengths(d, restitution):
    job = build(
        space={"cells": [20]},
        velocity={"points": [12] * d},
        collision={
            "operator": "granular-es-bgk", "knudsen": 0.3, "restitution": restitution,
            "relaxation": {"coefficient": 12.0},
        },
        initial={"state": "uniform", "density": 0.8, "temperature": 1.7},
        time={"end": 1.0},
    )  # fmt: skip
    gas = stability.CoolingGas.create(job.collision, d, 0.8, 1.7)
    k = 2 * np.pi / (gas.heat_wavelength * np.array([0.99, 1.01]))
    decays, grows = gas.heat_growth(k)
    assert decays < 0 < grows or decays < grows  # sound may be the faster one where the gas is far from elastic
    if d > 1:
        below, above = gas.shear_growth(2 * np.pi / (gas.shear_wavelength * np.array([0.99, 1.01])))
        assert below < 0 < above
        # viscosity of the model: the rate tau/Pr, the drag's zeta, less half of zeta by which the speed of sound falls
        rate = 12.0 * 0.8 * 1.7**0.5 / 0.3 / job.collision.prandtl
        assert gas.viscosity == pytest.approx(0.8 * 1.7 / (rate + gas.cooling / 2), rel=1e-12)


def test_hard_spheres_against_the_published_critical_wavelengths():
    """k = sqrt(zeta/eta) and sqrt(2 zeta/(kappa - mu)) in the reduced units of Brey and others, without a2.

    zeta* = 5/12 (1 - e^2), eta* = 1/(nu_s* - zeta*/2), kappa* = (2/3)/(nu_q* - 2 zeta*), mu* = 2 zeta* kappa*/(2 nu_q*
    - 3 zeta*), rates over P/eta0; k in units of nu0/(2 v0), v0 = sqrt(T), with eta0 = P/nu0.
    """
    for e in (0.7, 0.9, 0.98):
        job = build(
            space={"cells": [20]}, velocity={"points": [8, 8, 8]}, time={"end": 1.0}, initial={"state": "uniform"},
            collision={"operator": "boltzmann", "knudsen": 0.3, "restitution": e},
        )  # fmt: skip
        gas = stability.CoolingGas.create(job.collision, 3, 1.0, 1.0)
        nu = kinetic_theory.shear_rate(3, 0.25) / 0.3
        zeta = 5 / 12 * (1 - e**2)
        shear, heat = (1 + e) * (3 - e) / 4, (1 + e) / 3 * (1 + 33 / 16 * (1 - e))
        eta, kappa = 1 / (shear - zeta / 2), 2 / 3 / (heat - 2 * zeta)
        mu = 2 * zeta * kappa / (2 * heat - 3 * zeta)
        assert gas.cooling == pytest.approx(zeta * nu, rel=1e-12)
        assert gas.shear_wavelength == pytest.approx(2 * np.pi / (nu * np.sqrt(zeta / (2 * eta))), rel=1e-12)
        # kappa0 = 15/4 eta0 of a gas of unit mass: (2/3)(kappa0)(kappa* - mu*)/(2/3) k^2 = zeta/2
        assert gas.conductivity == pytest.approx(15 / 4 / nu * kappa * 1.0, rel=1e-12)
        assert gas.density_conductivity == pytest.approx(15 / 4 / nu * mu, rel=1e-12)
        assert gas.heat_wavelength == pytest.approx(
            2 * np.pi / (nu * np.sqrt(3 * zeta / 4 / (15 / 4 * (kappa - mu)))), rel=1e-12
        )
