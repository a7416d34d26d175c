"""Constants derived on paper, against direct integration of the collision operator they come from."""

from math import gamma, pi, sqrt

import numpy as np
import pytest

from rvm_mpi.kinetic_theory import dissipation_coefficient, hard_sphere_relaxation, sphere_area


def test_table_of_dissipation_coefficients():
    table = [dissipation_coefficient(d, 1.0) for d in (1, 2, 3)]
    assert table == pytest.approx([1 / sqrt(pi), 0.75 * pi**1.5, 8 * sqrt(pi)], rel=1e-14)
    assert dissipation_coefficient(3, 0.25) == pytest.approx(2 * sqrt(pi), rel=1e-14)


def test_hard_spheres():
    assert hard_sphere_relaxation(3, 1.0, 1.0) == pytest.approx(64 / 5 * sqrt(pi), rel=1e-14)
    assert hard_sphere_relaxation(3, 0.25, 2 / 3) == pytest.approx(3.781234881931767, rel=1e-12)
    assert hard_sphere_relaxation(2, 1.0, 1.0) == pytest.approx(10.4405, rel=1e-4)
    with pytest.raises(ValueError, match="no viscosity"):
        hard_sphere_relaxation(1, 1.0, 1.0)


def directions(rng, d, count):
    """Unit vectors, uniform on the sphere; in one dimension the two signs."""
    vectors = rng.standard_normal((count, d))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def collide(v, w, sigma, e):
    """Velocities after a collision with restitution e, sigma representation."""
    relative = v - w
    speed = np.linalg.norm(relative, axis=1, keepdims=True)
    change = (1 + e) / 4 * (speed * sigma - relative)
    return v + change, w - change


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0])
def test_dissipation_by_monte_carlo(d, exponent):
    """Energy lost by pairs from a Maxwellian, collided one by one."""
    rng = np.random.default_rng(11 * d)
    count, rho, temperature, e, b = 400_000, 1.7, 0.6, 0.4, 0.3
    v, w = sqrt(temperature) * rng.standard_normal((2, count, d))
    speed = np.linalg.norm(v - w, axis=1)
    v_after, w_after = collide(v, w, directions(rng, d, count), e)
    lost = 0.5 * ((v**2).sum(1) + (w**2).sum(1) - (v_after**2).sum(1) - (w_after**2).sum(1))
    sample = 0.5 * rho**2 * b * sphere_area(d) * speed**exponent * lost
    expected = (
        (1 - e**2) * dissipation_coefficient(d, b, exponent) * rho**2 * temperature ** (1 + exponent / 2)
    )
    assert sample.mean() == pytest.approx(expected, abs=4 * sample.std() / sqrt(count))
    assert sample.std() / sqrt(count) < 0.01 * expected


@pytest.mark.parametrize("d", [2, 3])
def test_hard_sphere_relaxation_by_monte_carlo(d):
    """Rate at which elastic hard spheres lose a small shear stress, f = M (1 + A c_x c_y / T)."""
    rng = np.random.default_rng(5 * d)
    count, rho, temperature, b = 1_000_000, 1.3, 0.7, 0.4
    v, w = sqrt(temperature) * rng.standard_normal((2, count, d))
    speed = np.linalg.norm(v - w, axis=1)
    v_after, w_after = collide(v, w, directions(rng, d, count), 1.0)

    def stress(c):
        return c[:, 0] * c[:, 1]

    change = stress(v_after) + stress(w_after) - stress(v) - stress(w)
    # per unit A: f f* is M M* (stress(v) + stress(w)) / T, and the stress itself is rho T
    sample = 0.5 * rho**2 * b * sphere_area(d) * speed * change * (stress(v) + stress(w)) / temperature
    rate = -sample.mean() / (rho * temperature)
    error = sample.std() / sqrt(count) / (rho * temperature)
    expected = hard_sphere_relaxation(d, b, 1.0) * rho * sqrt(temperature)
    assert rate == pytest.approx(expected, abs=4 * error)
    assert error < 0.01 * expected


def test_hard_sphere_viscosity_is_chapman_and_enskogs():
    """mu = (5/16) sqrt(pi T) / (4 pi b) in three dimensions, first Sonine approximation."""
    b, temperature, prandtl = 0.25, 2.0, 2 / 3
    tau = hard_sphere_relaxation(3, b, prandtl) * sqrt(temperature)
    assert prandtl * temperature / tau == pytest.approx(
        5 / 16 * sqrt(pi * temperature) / (4 * pi * b), rel=1e-14
    )


def test_sphere_area():
    assert [sphere_area(d) for d in (1, 2, 3)] == pytest.approx([2, 2 * pi, 4 * pi], rel=1e-15)
    assert sphere_area(5) == pytest.approx(2 * pi**2.5 / gamma(2.5))
