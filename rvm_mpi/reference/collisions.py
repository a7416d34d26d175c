"""Collisions: cooling, and the implicit relaxation to the discrete Gaussian; with it the end of a stage."""

from __future__ import annotations

import numpy as np

from rvm_mpi.reference.gaussians import corrected, corrected_signed, discrete_gaussian
from rvm_mpi.reference.state import Array, Problem, second_moments, sums, temperature

#: greatest depth of a relaxation: beyond it the explicit part is lost to rounding
DEEPEST = 1e12


def cooling(p: Problem) -> float:
    """C/eps of the granular drag; the Boltzmann operator's loss of energy is its own."""
    return 0.0 if p.job.collision.explicit else p.job.collision.cooling


def haff(p: Problem, U: Array, dt: float) -> Array:
    """H: homogeneous cooling over dt, T -> T/(1 + (C/eps) rho sqrt(T) dt)^2."""
    rho, T = U[..., 0], temperature(p, U)
    lost = T - T / (1.0 + cooling(p) * rho * np.sqrt(T) * dt) ** 2
    return U - 0.5 * p.d * (rho * lost)[..., None] * np.array([0.0, 0.0, 0.0, 0.0, 1.0])


def relaxes(p: Problem) -> bool:
    """Whether there is a relaxation to take implicitly."""
    return p.job.collision.relaxation is not None or bool(p.job.collision.penalise)


def relaxation_rate(p: Problem, density: Array, T: Array) -> Array:
    """tau/eps = coefficient rho^p T^q/eps."""
    law, eps = p.job.collision.relaxation, p.job.collision.knudsen
    assert law is not None and eps is not None
    return law.coefficient * density**law.density_power * T**law.temperature_power / eps


def anisotropy(p: Problem) -> float:
    """nu = 1 - 1/Pr; a penalised operator relaxes to Maxwellians."""
    return 0.0 if p.job.collision.prandtl is None else 1.0 - 1.0 / p.job.collision.prandtl


def gaussian_of(p: Problem, g: Array) -> Array:
    """G[g] of a cell: its mass, momentum and energy, the tensor (1 - nu) T I + nu Theta."""
    density = g.sum()
    u = sums(p, g)[1 : 1 + p.d] / density
    return discrete_gaussian(p, density, u, relaxed(p, second_moments(p, g) / density - np.outer(u, u)))


def relaxed(p: Problem, theta: Array) -> Array:
    """(1 - nu) T I + nu Theta, T = tr Theta/d."""
    nu = anisotropy(p)
    return (1.0 - nu) * np.trace(theta) / p.d * np.eye(p.d) + nu * theta


def finished(
    p: Problem, explicit: Array, begin: Array, wanted: Array, before: Array, weights: tuple[float, float, float]
) -> Array:
    """g' of a cell from the explicit part of its stage.

    Parameters
    ----------
    explicit, begin : (px, py, pz) arrays
        The explicit part, and g^n.
    wanted, before : (5,) arrays
        Sums of 1, xi, |xi|^2/2 that g' is to have, and those of g^n.
    weights : tuple of three
        The sum of all but that of G'; that of G^n; that of G'.
    """
    known, first, last = weights
    W, share = known + last, first + last
    spectral, conservative = p.job.collision.explicit, bool(p.job.scheme.conservative)
    if conservative and not spectral:
        explicit = corrected(p, explicit, known * wanted - first * before)
    rho, u = wanted[0], wanted[1 : 1 + p.d] / wanted[0]
    T = (2.0 * wanted[4] / rho - np.sum(u**2)) / p.d
    if relaxes(p) and share > 0.0:
        explicit = explicit + share * mixture(p, explicit, begin, (rho, u, T), weights)
    if conservative and spectral:  # after the Gaussian is mixed in: the explicit part is far from positive before
        explicit = corrected_signed(p, explicit, discrete_gaussian(p, rho, u, T * np.eye(p.d)), W * wanted)
    return explicit / W


def mixture(
    p: Problem, explicit: Array, begin: Array, end: tuple[float, Array, float], weights: tuple[float, float, float]
) -> Array:
    """(first G^n + last G')/(first + last) as one Gaussian; end: rho, u, T (of xi, sums over the nodes) of g'."""
    (known, first, last), (rho, u, T), nu = weights, end, anisotropy(p)
    W, share, one = known + last, first + last, np.eye(p.d)
    # G^n: second moments rho (Theta + u u) with (1 - nu) T I + nu Theta for Theta
    rho0, u0 = begin.sum(), sums(p, begin)[1 : 1 + p.d] / begin.sum()
    second0 = rho0 * (relaxed(p, second_moments(p, begin) / rho0 - np.outer(u0, u0)) + np.outer(u0, u0))
    # G': (W - w nu) rho Theta = second moments of what is known + w (1 - nu) rho T I - (W - w) rho u u, w = last
    stress = second_moments(p, explicit) + first * second0 - known * rho * np.outer(u, u)
    stress = (stress + last * (1.0 - nu) * rho * T * one) / (W - last * nu)
    second = (1.0 - nu) * rho * T * one + nu * stress + rho * np.outer(u, u)
    density = (first * rho0 + last * rho) / share
    mean = (first * rho0 * u0 + last * rho * u) / (share * density)
    tensor = (first * second0 + last * second) / (share * density) - np.outer(mean, mean)
    return discrete_gaussian(p, density, mean, tensor)
