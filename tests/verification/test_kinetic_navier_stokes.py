"""Viscosity, thermal conductivity and Prandtl number of ES-BGK from decaying waves at small Knudsen number."""

import numpy as np
import pytest

from tests.verification.kinetic_cases import orders
from tests.verification.navier_stokes import conductivity, viscosity


@pytest.mark.parametrize("scaling", ["none", "kinetic", "thermal"])
def test_viscosity(scaling):
    """mu = Pr p eps/tau: k times the mean free path is 0.06, its square changes the rate by less than 0.5 %."""
    drift = "maxwellian" if scaling == "thermal" else "van-leer"
    found = viscosity(0.01, 64, (10, 10, 10), scaling, drift)
    print(f"{scaling}: mu tau/(p eps) = {found:.5f}, Chapman and Enskog {2 / 3:.5f}")
    assert found == pytest.approx(2 / 3, rel=0.01)


def test_prandtl_number():
    mu, kappa = (f(0.01, 64, (10, 10, 10), "none") for f in (viscosity, conductivity))
    print(f"mu tau/(p eps) = {mu:.5f}, kappa 2 tau/(5 p eps) = {kappa:.5f}, Prandtl number {mu / kappa:.5f}")
    assert mu == pytest.approx(2 / 3, rel=0.02)
    assert kappa == pytest.approx(1.0, rel=0.02)
    assert mu / kappa == pytest.approx(2 / 3, rel=0.02)


@pytest.mark.parametrize(("points", "drift"), [(12, "seventh-order"), (24, "seventh-order-positive")])
def test_conductivity_in_rescaled_velocities(points, drift):
    """A temperature gradient is a gradient of omega: linear reconstructions make its heat flux on coarse grids."""
    exact = conductivity(0.02, 24, (24,), "none", prandtl=1.0)
    found = conductivity(0.02, 24, (points,), "kinetic", drift, 1.0)
    print(f"{drift}, {points} velocities: {found:.4f}, in classical variables {exact:.4f}")
    assert found == pytest.approx(exact, rel=0.01)


def test_conductivity_with_van_leer_converges_with_the_velocity_grid():
    """The limited drift's error is a heat flux: too small a conductivity, second order in the spacing."""
    exact = conductivity(0.02, 24, (24,), "none", prandtl=1.0)
    found = np.array([conductivity(0.02, 24, (n,), "kinetic", "van-leer", 1.0) for n in (24, 48, 96)])
    rate = orders(np.diff(found))
    print(f"{found} with 24, 48, 96 velocities, order {rate}; in classical variables {exact:.4f}")
    assert np.all(abs(found - exact) < (0.15, 0.06, 0.035))
    assert rate[0] > 1.5
