"""The order of the time scheme with space on a fixed grid, from a rarefied gas to the fluid limit."""

import numpy as np
import pytest

from tests.verification.kinetic_cases import orders
from tests.verification.time_order import errors

REGIMES = {
    "eps=1": lambda dt: 1.0,
    "eps=dt": lambda dt: dt,
    "eps=dt/10": lambda dt: 0.1 * dt,
    "eps=1e-6": lambda dt: 1e-6,
}


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("scheme", [("none", "van-leer", 24), ("kinetic", "seventh-order", 48)], ids=lambda s: s[0])
def test_second_order_in_time(scheme, regime):
    """Density, temperature and heat flux, which is itself O(eps) at eps = 1e-6 and not compared there."""
    scaling, drift, points = scheme
    found = errors(REGIMES[regime], (40, 80, 160), 640, points=[points], scaling=scaling, drift=drift)
    rates = orders(found)
    print(f"{regime}, {scaling}: errors {np.array(found).tolist()}, orders {rates.round(2).tolist()}")
    compared = slice(0, 2) if regime == "eps=1e-6" else slice(None)
    assert rates[:, compared].min() > 1.75
    assert max(found[0]) < 3e-5


def test_correction_leaves_a_small_first_order_remainder():
    """On a coarse velocity grid with Van Leer's limiter each stage corrects g by what the drift's error leaves, as an
    implicit Euler step would: first order in dt, but times the square of the velocity spacing."""
    remainder = {}
    for points in (24, 48):
        found = np.array(errors(REGIMES["eps=1"], (80, 160), 1280, points=[points], drift="van-leer"))
        remainder[points] = (4 * found[1] - found[0])[2]  # what does not fall by four, of the heat flux
        print(f"{points} velocities: errors {found.tolist()}, orders {orders(found).round(2).tolist()}")
        assert found[0].max() < 4e-6
    assert remainder[48] < 0.6 * remainder[24]
