"""Constants of kinetic theory that tie the relaxation operators to a collision kernel.

The kernel is B = |u|^lambda b in the sigma representation with a constant cross section b; lambda = 1 is hard
spheres, lambda = 0 Maxwell molecules, u the relative velocity.
"""

from __future__ import annotations

from math import gamma, pi


def sphere_area(dimensions: int) -> float:
    """Area |S^{d-1}| of the unit sphere in d dimensions; |S^0| = 2."""
    return 2.0 * pi ** (dimensions / 2) / gamma(dimensions / 2)


def dissipation_coefficient(dimensions: int, cross_section: float, exponent: float = 1.0) -> float:
    """k_d, the rate at which inelastic collisions take energy out of a Maxwellian.

    A Maxwellian of density rho and temperature T loses energy at the rate
    (1 - e^2) k_d rho^2 T^(1 + lambda/2) / Knudsen number, with
    k_d = b |S^{d-1}| 2^lambda Gamma((d + lambda + 2)/2) / (4 Gamma(d/2)).

    A collision takes (1 - e^2)/4 |u|^2 (1 - cos)/2 out of the pair; the average over sigma of
    |u|^(2 + lambda) and over u, a Gaussian of variance 2 T, gives the formula.
    """
    d, power = dimensions, exponent
    return cross_section * sphere_area(d) * 2.0**power * gamma((d + power + 2) / 2) / (4 * gamma(d / 2))


def hard_sphere_relaxation(dimensions: int, cross_section: float, prandtl: float) -> float:
    """Coefficient of the ES-BGK rate tau = coefficient rho T^(1/2) that has the viscosity of hard spheres.

    First Sonine approximation: shear stress decays at the rate P/mu = Lambda rho T^(1/2) with
    Lambda = 4 b |S^{d-1}| Gamma((d + 5)/2) / (d (d + 2) Gamma(d/2)), which is (64/5) sqrt(pi) b in d = 3 and
    (15/8) pi^(3/2) b = 10.44 b in d = 2; ES-BGK has mu = P Pr / tau, hence tau = Pr P/mu.
    One dimension has no shear: ValueError.
    """
    d = dimensions
    if d == 1:
        raise ValueError("one velocity dimension has no viscosity to match")
    shear = 4 * cross_section * sphere_area(d) * gamma((d + 5) / 2) / (d * (d + 2) * gamma(d / 2))
    return prandtl * shear
