"""Homogeneous cooling states of hard spheres against Sonine theory, and Haff's law over four decades of temperature."""

import pytest

from tests.verification.cooling_state import cool, cooling_state, stationary, van_noije_ernst


@pytest.mark.parametrize("e", [0.0, 0.5, 0.7, 0.9])
def test_the_theory_is_that_of_van_noije_and_ernst(e):
    """In d = 3 constant b in sigma is the hard sphere."""
    (a,), _ = cooling_state(3, e, 2, linear=True)
    assert a == pytest.approx(van_noije_ernst(3, e), abs=1e-12)


@pytest.mark.parametrize(
    "d, points, half_width, e, tolerance",
    [(2, 32, 9.0, 0.7, 2e-4), (2, 32, 9.0, 0.9, 1e-4), (3, 20, 7.0, 0.9, 1e-3)],
)
def test_the_operator_keeps_the_state_of_the_theory(d, points, half_width, e, tolerance):
    """a_2 and the rate of cooling, by a spectral drift; eight Sonine coefficients have converged to 1e-5."""
    a, factor = stationary(d, e, points, half_width)
    coefficients, expected = cooling_state(d, e, 8)
    print(f"d = {d}, e = {e}: a_2 = {a:.5f}, theory {coefficients[0]:.5f}; rate {factor:.5f}, theory {expected:.5f}")
    assert a == pytest.approx(coefficients[0], abs=tolerance)
    assert factor == pytest.approx(expected, abs=5 * tolerance)


@pytest.mark.parametrize(
    "points, half_width, drift, e, tolerance, tolerance_a",
    [
        (32, 9.0, "van-leer", 0.9, 0.005, 0.015),
        (32, 9.0, "maxwellian", 0.5, 0.003, 0.005),
        (48, 10.0, "van-leer", 0.8, 0.005, 0.015),
        (32, 9.0, "seventh-order", 0.7, 0.001, 3e-4),
        (32, 9.0, "seventh-order", 0.9, 0.001, 3e-4),
    ],
)
def test_haffs_law_over_four_decades(points, half_width, drift, e, tolerance, tolerance_a):
    """Whole runs, d = 2, from a Maxwellian: T near the law; a_2 by what the drift's reconstruction leaves of it."""
    coefficients, factor = cooling_state(2, e, 8)
    a, ratio, _, steps = cool(2, e, points, half_width, drift, factor)
    print(f"e = {e}: T over Haff's {ratio:.5f} after {steps} steps, a_2 = {a:.4f}, theory {coefficients[0]:.4f}")
    assert ratio == pytest.approx(1.0, abs=tolerance)
    assert a == pytest.approx(coefficients[0], abs=tolerance_a)
