"""The homogeneous cooling state of a kernel |u|^lambda b: Sonine theory to any order, and runs to compare it with.

Velocities in units of sqrt(T), T = <|v|^2>/d, unit density and mass:

    g = Gaussian (1 + sum_{m >= 2} a_m S_m(|v|^2/2)),   a_2 = <|v|^4>/(d (d + 2)) - 1,

S_m the generalised Laguerre polynomials of index d/2 - 1. The state cools without a change of shape where, Q_p being
the collisional rate of change of <|v|^(2 p)>,

    Q_p = p <|v|^(2 p)> Q_1 / d,   p = 2, 3, ...

van Noije and Ernst, Granular Matter 1, 57 (1998), take a_2 alone and keep what is linear in it, for hard spheres and
discs (kernel |u . n| in the impact direction n). Here the average over the constant cross section b in sigma is done
by Gauss quadrature of polynomials, hence exact, in d = 2 and 3; in d = 3 that is the hard sphere.
"""

from math import gamma

import numpy as np
from scipy.optimize import fsolve
from scipy.special import eval_genlaguerre, roots_genlaguerre, roots_jacobi

from rvm_mpi import Simulation
from rvm_mpi.collisions.boltzmann import BoltzmannOperator
from rvm_mpi.kinetic_theory import dissipation_coefficient, sphere_area
from tests.verification.kinetic_cases import build


def collision_moments(d, e, order, exponent=1.0):
    """(p, m, l) array: Q_p of the pair S_m, S_l for b = 1, p = 0..order; two particles have W +- u/2, then W +- u'/2.

    The centre of mass W and u are independent Gaussians of variance 1/2 and 2 a component.
    """
    n = 2 * order + 2
    x, weight_x = roots_genlaguerre(n, (d + exponent) / 2 - 1)
    y, weight_y = roots_genlaguerre(n, d / 2 - 1)
    c, weight_c = roots_jacobi(n, (d - 3) / 2, (d - 3) / 2)
    t, weight_t = roots_jacobi(n, (d - 4) / 2, (d - 4) / 2) if d > 2 else (np.array([-1.0, 1.0]), np.ones(2))
    u, w = 2 * np.sqrt(x)[:, None, None], np.sqrt(y)[None, :, None]
    weight = 2**exponent * weight_x[:, None, None] * weight_y[:, None] * weight_c
    weight /= gamma(d / 2) ** 2 * weight_c.sum()
    # sigma has the component s along u, and t sqrt(1 - s^2) along the part of W across u
    s = c
    sine = np.sqrt(1 - c**2)
    along, across = (1 - e) / 2, (1 + e) / 2
    angle = weight_c[:, None] * weight_t / (weight_c.sum() * weight_t.sum())
    square = np.zeros((order + 1, n, n, n))
    for i in range(n):
        for j in range(len(t)):
            product = along * c + across * (c * s[i] + sine * sine[i] * t[j])
            new = w**2 + u**2 / 4 * (along**2 + across**2 + 2 * along * across * s[i]) + u * w * product
            for p in range(order + 1):
                square[p] += angle[i, j] * new**p
    one, other = w**2 + u**2 / 4 + u * w * c, w**2 + u**2 / 4 - u * w * c
    # both particles' powers after, for v' and v'_* have the same average
    change = np.stack([2 * square[p] - one**p - other**p for p in range(order + 1)])
    sonine = [np.stack([eval_genlaguerre(m, d / 2 - 1, v / 2) for m in range(order + 1)]) for v in (one, other)]
    rates = np.einsum("pxyc,mxyc,lxyc,xyc->pml", change, *sonine, weight, optimize=True)
    return 0.5 * sphere_area(d) * rates


def cooling_state(d, e, order=2, linear=False, exponent=1.0):
    """a_2, ..., a_order of the cooling state, and its rate of cooling over that of a Gaussian."""
    rates = collision_moments(d, e, order, exponent)
    powers = np.arange(order + 1)
    x, weight = roots_genlaguerre(2 * order + 2, d / 2 - 1)
    sonine = np.stack([eval_genlaguerre(m, d / 2 - 1, x) for m in range(order + 1)])
    moments = np.einsum("px,mx,x->pm", (2 * x) ** powers[:, None], sonine, weight) / gamma(d / 2)

    def remainder(a):
        c = np.concatenate([[1.0, 0.0], a])
        q = rates @ c @ c
        return (q - powers * (moments @ c) * q[1] / d)[2:]

    def derivative(a):
        c = np.concatenate([[1.0, 0.0], a])
        q, by = rates @ c @ c, ((rates + rates.swapaxes(1, 2)) @ c)
        by = by - powers[:, None] * (moments * q[1] + np.outer(moments @ c, by[1])) / d
        return by[2:, 2:]

    zero = np.zeros(order - 1)
    a = -np.linalg.solve(derivative(zero), remainder(zero))
    if not linear:
        a = fsolve(remainder, a, fprime=derivative, xtol=1e-12)
    c = np.concatenate([[1.0, 0.0], a])
    q = rates[1]
    factor = (1 + 2 * (q[0, 2:] @ a) / q[0, 0]) if linear else (c @ q @ c) / q[0, 0]
    return a, factor


def van_noije_ernst(d, e):
    """a_2 of hard spheres and discs, linear first Sonine order."""
    return 16 * (1 - e) * (1 - 2 * e**2) / (9 + 24 * d + 8 * e * d - 41 * e + 30 * e**2 * (1 - e))


def nodes(d, points, half_width):
    """Velocities (d, points, ...) of a grid, and |v|^2."""
    axis = (np.arange(points) + 0.5) * 2 * half_width / points - half_width
    v = np.stack(np.meshgrid(*[axis] * d, indexing="ij"))
    return v, (v**2).sum(axis=0)


def cumulant(g, square, d):
    """a_2 of g."""
    return (square**2 * g).sum() * d * g.sum() / ((d + 2) * (square * g).sum() ** 2) - 1


def sponge(square, half_width):
    """What a step leaves: outside the operator's support nothing collides, and what has drifted there must go."""
    return np.exp(-3 * np.minimum(square / half_width**2, 3.0) ** 12)


def stationary(d, e, points, half_width, tolerance=1e-6):
    """a_2 and the rate of cooling over that of a Gaussian, of the state that the operator itself keeps.

    dg/dt = Q(g, g) - zeta div(v g), zeta from Q's own loss of energy, the divergence by Fourier's derivative, steps of
    Runge and Kutta: no reconstruction in velocity space, so what is left is the error of the operator.
    """
    operator = BoltzmannOperator.create((points,) * d, half_width, e)
    v, square = nodes(d, points, half_width)
    wave = np.fft.fftfreq(points, 1 / points) * np.pi / half_width
    wave[points // 2] = 0.0
    derivative = np.fft.ifft(1j * wave[:, None] * np.fft.fft(np.eye(points), axis=0), axis=0).real
    weight = (2 * half_width / points) ** d
    cooling = (1 - e**2) * dissipation_coefficient(d, 1.0) / d
    # collisions of the fastest pair, and the spectral drift at the edge
    step = 2 / (sphere_area(d) * operator.support_radius * 2 + cooling * d * np.pi * points / 2)
    keep = sponge(square, half_width)
    out = np.empty((1, *square.shape))

    def rate(g):
        operator.collide(g[None], out)
        zeta = -(square * out[0]).sum() / (2 * (square * g).sum())
        spread = sum(np.moveaxis(np.tensordot(derivative, v[a] * g, (1, a)), 0, a) for a in range(d))
        return out[0] - zeta * spread, zeta

    g = np.exp(-square / 2)
    g /= g.sum() * weight
    before = 1.0
    while True:
        for _ in range(10):
            start, stage, total = g, g, 0.0
            for part, share in ((0.5, 1 / 6), (0.5, 1 / 3), (1.0, 1 / 3), (0.0, 1 / 6)):
                change, zeta = rate(stage)
                total = total + share * change
                stage = start + part * step * change
            g = (start + step * total) * keep
            g /= g.sum() * weight
            fourth, excess = (square**2 * g).sum() * weight, (square * g).sum() * weight - d
            g *= 1 - excess * (square - d) / (fourth - d**2)
        now = cumulant(g, square, d)
        if not abs(now) < 1:
            raise ArithmeticError("no stationary state")
        if abs(now - before) < tolerance * 10 * step * sphere_area(d):
            return now, zeta / cooling
        before = now


def cool(d, e, points, half_width, drift="van-leer", factor=1.0, decades=4):
    """A run from a Maxwellian until Haff's law with that factor on its rate has cooled it by so many decades.

    Returns a_2 of g, T over the law's T, the largest departure of log T from a straight law over the last two decades,
    and the steps.
    """
    tables = {
        "space": {"cells": []},
        "velocity": {"points": [points] * d, "half_width": half_width},
        "scheme": {"drift": drift},
        "collision": {"operator": "boltzmann", "knudsen": 1.0, "restitution": e},
        "initial": {"state": "uniform"},
    }
    cooling = build(**tables, time={"end": 1.0}).collision.cooling * factor
    end = (10 ** (decades / 2) - 1) / cooling
    simulation = Simulation(build(**tables, time={"end": end}))
    kinetic = simulation.kinetic
    _, square = nodes(d, points, half_width)
    times, temperatures = [0.0], [1.0]
    for _ in simulation:
        times.append(simulation.time)
        temperatures.append(simulation.diagnostics.row["mean_temperature"])
    ratio = np.sqrt(temperatures) * (1 + cooling * np.array(times))
    g = kinetic.velocity_grid.unpack(kinetic.state()[0][0, 0]).reshape(square.shape)
    return cumulant(g, square, d), ratio[-1] ** 2, np.ptp(2 * np.log(ratio[len(ratio) // 2 :])), simulation.number
