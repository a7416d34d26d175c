"""Constants derived on paper, against direct integration of the collision operator they come from."""

from math import gamma, pi, sqrt

import numpy as np
import pytest

from rvm_mpi import kinetic_theory
from rvm_mpi.job.job import Job
from rvm_mpi.kinetic_theory import (
    PATH_PER_VISCOSITY,
    dissipation_coefficient,
    hard_sphere_relaxation,
    heat_flux_rate,
    mean_speed,
    shear_rate,
    sphere_area,
)


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


@pytest.mark.parametrize("e", [0.3, 0.8, 1.0])
def test_decay_rates_of_hard_spheres_are_those_of_brey_and_others(e):
    """Brey, Dufty, Kim and Santos (1998), over the elastic shear rate."""
    shear = shear_rate(3, 0.4)
    assert shear == pytest.approx(64 / 5 * sqrt(pi) * 0.4, rel=1e-14)
    assert shear_rate(3, 0.4, restitution=e) / shear == pytest.approx((1 + e) * (3 - e) / 4, rel=1e-14)
    assert heat_flux_rate(3, 0.4, restitution=e) / shear == pytest.approx((1 + e) / 3 * (1 + 33 / 16 * (1 - e)))


@pytest.mark.parametrize(("d", "exponent", "e"), [(2, 0.0, 0.7), (2, 1.0, 0.9), (3, 0.5, 0.6), (1, 1.0, 0.5)])
def test_decay_rates_by_monte_carlo(d, exponent, e):
    """Pairs from a Maxwellian with a little shear stress or heat flux, collided one by one."""
    rng = np.random.default_rng(3 * d)
    count, temperature, b = 1_000_000, 0.7, 0.4
    v, w = sqrt(temperature) * rng.standard_normal((2, count, d))
    relative = np.linalg.norm(v - w, axis=1)
    v_after, w_after = collide(v, w, directions(rng, d, count), e)

    def heat(c):
        return c[:, 0] * ((c**2).sum(1) - (d + 2) * temperature) / 2

    def stress(c):
        return c[:, 0] * c[:, 1]

    quantities = [(heat, heat_flux_rate, (d + 2) * temperature**3 / 2)]
    if d > 1:
        quantities.append((stress, shear_rate, temperature**2))
    for quantity, rate, square in quantities:
        change = quantity(v_after) + quantity(w_after) - quantity(v) - quantity(w)
        sample = -0.5 * b * sphere_area(d) * relative**exponent * change * (quantity(v) + quantity(w)) / square
        expected = rate(d, b, exponent, e) * temperature ** (exponent / 2)
        error = sample.std() / sqrt(count)
        assert sample.mean() == pytest.approx(expected, abs=4 * error)
        assert error < 0.03 * expected


def collision_of(**keys):
    points = [8] * keys.pop("d", 3)
    given = {"operator": "es-bgk", "knudsen": 0.2} | keys
    return Job.from_dict(
        {
            "space": {"cells": []}, "velocity": {"points": points}, "collision": given,
            "initial": {"state": "uniform"}, "time": {"end": 1.0},
        }
    ).collision  # fmt: skip


BOLTZMANN = {"operator": "boltzmann", "restitution": 1.0}
N, T = np.array([0.5, 3.0]), np.array([2.0, 0.3])


@pytest.mark.parametrize("b", [0.25, 1.0])
@pytest.mark.parametrize("keys", [{"prandtl": 2 / 3}, {"prandtl": 1.0}, {"prandtl": 1.7}, BOLTZMANN])
def test_mean_free_path_of_hard_spheres(keys, b):
    """1/(sqrt(2) pi n a^2), n a^2 = 4 b rho/eps, at any temperature and Prandtl number; the time between collisions."""
    collision = collision_of(**keys, cross_section=b)
    exact = 1 / (sqrt(2) * pi * 4 * b * N / 0.2)
    np.testing.assert_allclose(kinetic_theory.mean_free_path(collision, 3, N, T), exact, rtol=1e-14)
    loss = N * b * 4 * pi * sqrt(2) * mean_speed(3, T) / 0.2
    np.testing.assert_allclose(kinetic_theory.collision_time(collision, 3, N, T), 1 / loss, rtol=1e-14)


def test_mean_free_path_of_hard_discs():
    """mu = sqrt(T/pi)/(2 a) of hard discs of diameter a (Gass 1971, first order) belongs to 1/(2 sqrt(2) n a)."""
    a = 0.3
    coefficient = 0.5 * 2 * a * sqrt(pi)  # Pr P/mu at n = T = 1
    relaxation = {"coefficient": coefficient}
    collision = collision_of(d=2, knudsen=1.0, prandtl=0.5, relaxation=relaxation)
    np.testing.assert_allclose(kinetic_theory.mean_free_path(collision, 2, N, T), 1 / (2 * sqrt(2) * N * a), rtol=1e-14)
    for prandtl in (0.5, 0.8, 1.0):
        path = kinetic_theory.mean_free_path(collision_of(d=2, prandtl=prandtl), 2, N, T)
        np.testing.assert_allclose(path, kinetic_theory.mean_free_path(collision_of(d=2, **BOLTZMANN), 2, N, T))


def test_one_velocity_dimension_has_the_rates_own_path():
    collision = collision_of(d=1, relaxation={"coefficient": 2.0, "temperature_power": 0.0})
    path = kinetic_theory.mean_free_path(collision, 1, N, T)
    np.testing.assert_allclose(path, np.sqrt(2 * T / pi) / (2.0 * N / 0.2), rtol=1e-14)
    kernel = kinetic_theory.mean_free_path(collision_of(d=1, **BOLTZMANN, cross_section=0.3), 1, N, T)
    np.testing.assert_allclose(kernel, 0.2 / (0.3 * 2 * N) * np.sqrt(2 * T / pi) / np.sqrt(4 * T / pi), rtol=1e-14)


@pytest.mark.parametrize("exponent", [0.0, 0.6, 1.0])
def test_cooling_by_integrating_it(exponent):
    collision = collision_of(**BOLTZMANN | {"restitution": 0.8}, exponent=exponent)
    temperature, steps = 2.0, 20000
    for _ in range(steps):
        half = temperature * (1 - 0.5 * 0.3 / steps * kinetic_theory.cooling_rate(collision, 1.5, temperature))
        temperature -= half * 0.3 / steps * kinetic_theory.cooling_rate(collision, 1.5, half)
    assert kinetic_theory.cooled(collision, 1.5, 2.0, 0.3) == pytest.approx(temperature, rel=1e-6)
    time = kinetic_theory.cooling_time(collision, 1.5, 2.0, 4.0)
    assert kinetic_theory.cooled(collision, 1.5, 2.0, time) == pytest.approx(0.5, rel=1e-12)
    assert kinetic_theory.cooling_time(collision_of(**BOLTZMANN), 1.5, 2.0) == float("inf")


def test_argon_at_one_pascal_in_a_gap_of_one_centimetre():
    """The example of docs/units.md, from the gas's constants to a job and back."""
    k_boltzmann, mass, viscosity = 1.380649e-23, 39.948 * 1.66053907e-27, 22.7e-6
    speed = sqrt(k_boltzmann * 300 / mass)
    density = 1.0 / speed**2  # of 1 Pa
    path = PATH_PER_VISCOSITY[3] * viscosity / (density * speed)
    assert (speed, density, path) == pytest.approx((249.87, 1.6017e-5, 7.241e-3), rel=2e-4)
    knudsen = sqrt(2) * pi * path / 0.01
    assert knudsen == pytest.approx(3.217, rel=2e-4)
    collision = collision_of(knudsen=3.217)
    assert kinetic_theory.mean_free_path(collision, 3, 1.0, 1.0) == pytest.approx(0.7241, rel=2e-4)
    # its viscosity, in units of rho0 v0 L0, is argon's
    mu = kinetic_theory.viscosity(collision, 3, 1.0, 1.0) * density * speed * 0.01
    assert mu == pytest.approx(viscosity, rel=2e-4)
