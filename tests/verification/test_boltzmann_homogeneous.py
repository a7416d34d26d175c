"""The Boltzmann operator on distributions whose collision integral, or its moments, are known."""

from math import exp, pi

import numpy as np
import pytest

from rvm_mpi.collisions.boltzmann import BoltzmannOperator
from rvm_mpi.kinetic_theory import dissipation_coefficient, sphere_area

CROSS_SECTION = 0.7


def grid(d, points, half_width):
    """Velocities (d, points, ...) and the volume of a cell."""
    h = 2 * half_width / points
    x = (np.arange(points) + 0.5) * h - half_width
    return np.stack(np.meshgrid(*[x] * d, indexing="ij")), h**d


def operator(d, points, half_width, e, exponent):
    return BoltzmannOperator.create((points,) * d, half_width, e, exponent, CROSS_SECTION)


def collide(op, g):
    out = np.empty((1, *g.shape))
    op.collide(g[None], out)
    return out[0]


def gaussian(v, density, mean, temperature):
    d = v.shape[0]
    c = v - np.reshape(mean, (d, *(1,) * d))
    return density * (2 * pi * temperature) ** (-d / 2) * np.exp(-(c**2).sum(axis=0) / (2 * temperature))


# ---- Bobylev, Krook and Wu


def bkw(d, v, s):
    """Their solution of density and temperature one where its shape is s, and its time derivative.

    ds/dt = mu (1 - s), mu the rate of the fourth moment: b |S^{d-1}| (d - 1)/(4 d).
    """
    a = (v**2).sum(axis=0) / (2 * s)
    g = gaussian(v, 1.0, np.zeros(d), s)
    shape = 1 + (1 - s) / s * (a - d / 2)
    by_s = g * (a - d / 2) / s * shape + g * (-(a - d / 2) / s**2 - (1 - s) / s * a / s)
    mu = CROSS_SECTION * sphere_area(d) * (d - 1) / (4 * d)
    return g * shape, by_s * mu * (1 - s)


@pytest.mark.parametrize(
    "d, half_width, s, points, ceilings",
    [
        (2, 8.0, 0.7, (16, 24, 32), (0.2, 2e-3, 6e-6)),
        (2, 9.0, 0.7, (16, 24, 32, 48), (0.4, 1e-2, 8e-5, 5e-10)),
        (3, 6.0, 0.75, (12, 16, 20), (3e-2, 4e-3, 3e-4)),
        (3, 6.5, 0.75, (12, 16, 20, 24), (0.1, 7e-3, 5e-4, 5e-5)),
    ],
)
def test_bobylev_krook_wu(d, half_width, s, points, ceilings):
    errors = []
    for n in points:
        v, _ = grid(d, n, half_width)
        f, rate = bkw(d, v, s)
        errors.append(np.abs(collide(operator(d, n, half_width, 1.0, 0.0), f) - rate).max() / np.abs(rate).max())
    print(f"Bobylev, Krook and Wu, d = {d}, V = {half_width}: " + ", ".join(f"{e:.1e}" for e in errors))
    assert (np.array(errors) < ceilings).all()
    # faster than any power: the order itself rises
    orders = -np.diff(np.log(errors)) / np.diff(np.log(points))
    assert orders[0] > 6 and (np.diff(orders) > 0).all()


# ---- dissipation


@pytest.mark.parametrize("e", [0.0, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("exponent", [0.0, 1.0])
@pytest.mark.parametrize(
    "d, points, half_width, tolerance",
    [(1, 64, 12.0, 5e-10), (2, 32, 9.0, 6e-6), (2, 48, 10.0, 2e-7), (3, 16, 7.0, 3e-3)],
)
def test_dissipation_of_a_maxwellian(d, points, half_width, tolerance, e, exponent):
    """(1 - e^2) k_d rho^2 T^(1 + lambda/2); at e = 1 this is conservation of energy."""
    density, temperature = 1.3, 0.97
    v, weight = grid(d, points, half_width)
    q = collide(operator(d, points, half_width, e, exponent), gaussian(v, density, np.zeros(d), temperature))
    scale = dissipation_coefficient(d, CROSS_SECTION, exponent) * density**2 * temperature ** (1 + exponent / 2)
    lost = -0.5 * ((v**2).sum(axis=0) * q).sum() * weight / scale
    assert lost == pytest.approx(1 - e**2, abs=tolerance)
    assert abs(q.sum()) * weight < 1e-14 * np.abs(q).sum() * weight + 1e-14


@pytest.mark.parametrize("d, points, tolerance", [(2, 16, 3e-2), (2, 32, 3e-5), (3, 16, 2e-2)])
def test_elastic_collisions_keep_momentum_and_energy(d, points, tolerance):
    """Hard spheres, two Gaussians: the moments of Q beside those of |Q|."""
    half_width = 8.0 if d == 2 else 6.5
    v, _ = grid(d, points, half_width)
    shift = np.array([0.6, -0.3, 0.2])[:d]
    f = gaussian(v, 0.6, shift, 0.8) + gaussian(v, 0.4, -shift, 0.9)
    q = collide(operator(d, points, half_width, 1.0, 1.0), f)
    for moment in (*v, (v**2).sum(axis=0)):
        assert abs((moment * q).sum()) < tolerance * np.abs(moment * q).sum()


# ---- inelastic Maxwell molecules


@pytest.mark.parametrize("d, points, half_width, tolerance", [(1, 64, 12.0, 1e-7), (2, 48, 10.5, 1e-6)])
def test_maxwell_molecules_lose_energy_at_a_rate_their_shape_does_not_know(d, points, half_width, tolerance):
    """d rho/2 dT/dt = -(1 - e^2) k_d rho^2 T and no momentum, for two unlike Gaussians with a mean velocity."""
    e = 0.6
    v, weight = grid(d, points, half_width)
    f = gaussian(v, 0.7, [0.5, -0.4][:d], 0.8) + gaussian(v, 0.5, [-0.4, 0.5][:d], 1.1)
    q = collide(operator(d, points, half_width, e, 0.0), f)
    axes = tuple(range(1, d + 1))
    density = f.sum() * weight
    momentum = (v * f).sum(axis=axes) * weight
    heat = 0.5 * ((v**2).sum(axis=0) * f).sum() * weight - 0.5 * (momentum**2).sum() / density
    temperature = 2 * heat / (d * density)
    expected = (1 - e**2) * dissipation_coefficient(d, CROSS_SECTION, 0.0) * density**2 * temperature
    assert -0.5 * ((v**2).sum(axis=0) * q).sum() * weight == pytest.approx(expected, rel=tolerance)
    assert np.abs((v * q).sum(axis=axes)).max() * weight < tolerance * expected


def test_maxwell_molecules_cool_exponentially():
    """T = T0 exp(-2 (1 - e^2) k_d rho t / d), by fourth-order Runge-Kutta steps, d = 1."""
    e, end, steps = 0.6, 2.0, 40
    v, weight = grid(1, 64, 9.0)
    op = operator(1, 64, 9.0, e, 0.0)
    f = gaussian(v, 0.5, [0.8], 0.4) + gaussian(v, 0.5, [-0.8], 0.4)
    start = (v[0] ** 2 * f).sum() * weight
    dt = end / steps
    for _ in range(steps):
        a = collide(op, f)
        b = collide(op, f + 0.5 * dt * a)
        c = collide(op, f + 0.5 * dt * b)
        f = f + dt / 6 * (a + 2 * b + 2 * c + collide(op, f + dt * c))
    expected = start * exp(-2 * (1 - e**2) * dissipation_coefficient(1, CROSS_SECTION, 0.0) * end)
    assert (v[0] ** 2 * f).sum() * weight == pytest.approx(expected, rel=1e-6)
    assert expected < 0.7 * start
