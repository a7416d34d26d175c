"""The homogeneous cooling state of a kernel |u|^lambda b: Sonine theory to any order, and runs to compare it with.

Velocities in units of sqrt(T), T = <|v|^2>/d, unit density and mass:

    g = Gaussian (1 + sum_{m >= 2} a_m S_m(|v|^2/2)),   a_2 = <|v|^4>/(d (d + 2)) - 1,

S_m the generalised Laguerre polynomials of index d/2 - 1. The state cools without a change of shape where, Q_p being
the collisional rate of change of <|v|^(2 p)>,

    Q_p = p <|v|^(2 p)> Q_1 / d,   p = 2, 3, ...

van Noije and Ernst, Granular Matter 1, 57 (1998), take a_2 alone and keep what is linear in it, for hard spheres and
discs (cross section in the impact direction). Here the average over the constant cross section b in sigma is done
by Gauss quadrature of polynomials, hence exact, in d = 2 and 3; in d = 3 that is the hard sphere.
"""

from math import gamma

import numpy as np
from scipy.optimize import fsolve
from scipy.special import eval_genlaguerre, roots_genlaguerre, roots_jacobi

from rvm_mpi.kinetic_theory import sphere_area


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
