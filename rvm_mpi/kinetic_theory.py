"""Kinetic theory in the units of a job: the constants of the collision operators, and the one definition of each scale.

Units. A job has none of its own: choose a density rho0, a temperature T0 and a length L0. Then

- density is in units of rho0, the mass per volume;
- temperature T is the variance of one velocity component, k_B T/m of a physical gas, in units of k_B T0/m;
- speeds are in units of v0 = sqrt(k_B T0/m), so the speed of sound is sqrt((d + 2)/d T), and time in units of L0/v0;
- pressure rho T is in units of rho0 v0^2, heat flux in units of rho0 v0^3.

`collision.knudsen` (eps) divides the collision operator; it is the mean free path only up to a factor. The kernel is
B = |u|^lambda b in the sigma representation with a constant cross section b (`collision.cross_section`) and relative
velocity u; lambda = 1 is hard spheres, lambda = 0 Maxwell molecules. A gas of n spheres of diameter a per volume has
b/eps = n a^2 L0/4 at density rho0: with b = 1/4, eps = 1/(n a^2 L0) = sqrt(2) pi times mean free path/L0.
`collision.relaxation.coefficient` is the rate tau at rho = T = 1 and eps = 1 of tau = coefficient rho^p T^q, in v0/L0.

Scales. mu is the viscosity P/(rate at which a shear stress decays): Pr P eps/tau for the ES-BGK family, first Sonine
order for a kernel, elastic.

- mean free path: lambda = c_d mu/(rho sqrt(T)), c_3 = 16/(5 sqrt(2 pi)), c_2 = sqrt(pi/2): what it is for hard spheres,
  1/(sqrt(2) pi n a^2), and hard discs, 1/(2 sqrt(2) n a), of that viscosity. It does not depend on the Prandtl number
  where the viscosity does not. One velocity dimension has no viscosity: mean speed over the operator's rate there.
- collision time: mean free path over mean speed <|v|>; for hard spheres the mean time between collisions.
- Knudsen number: mean free path of the mean state over the length of the domain (`advice/physics.py`).
"""

from __future__ import annotations

from math import gamma, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rvm_mpi.job.schema import Collision

PATH_PER_VISCOSITY = {2: sqrt(pi / 2), 3: 16 / (5 * sqrt(2 * pi))}
"""c_d of the mean free path c_d mu/(rho sqrt(T)), by velocity dimensions."""


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


def shear_rate(dimensions: int, cross_section: float, exponent: float = 1.0, restitution: float = 1.0) -> float:
    """Rate at which collisions of a kernel |u|^exponent take away a shear stress, at rho = T = eps = 1.

    First Sonine order: b |S^{d-1}| 2^(lambda + 1) Gamma((d + 4 + lambda)/2) / (d (d + 2) Gamma(d/2)), times
    (1 + e)(3 - e)/4 where they are inelastic. It grows as rho T^(lambda/2); the elastic viscosity is P over it.
    """
    d, power, e = dimensions, exponent, restitution
    elastic = cross_section * sphere_area(d) * 2.0 ** (power + 1) * gamma((d + 4 + power) / 2)
    return elastic / (d * (d + 2) * gamma(d / 2)) * (1 + e) * (3 - e) / 4


def heat_flux_rate(dimensions: int, cross_section: float, exponent: float = 1.0, restitution: float = 1.0) -> float:
    """Rate at which collisions of a kernel |u|^exponent take away a heat flux, at rho = T = eps = 1.

    First Sonine order, by the means over sigma and over pairs of a Maxwellian:
    b |S^{d-1}| <|u|^(2 + lambda)> (alpha (d + 2)(2 + lambda) + beta (2 (d + 2) + 3 lambda)) / (8 d (d + 2)) with
    alpha = (1 - e^2)/4 - (1 + e)^2/(4 d) and beta = (1 + e)(3 - e)/4. Two thirds of `shear_rate` for elastic
    molecules in d = 3: Pr = 2/3.
    """
    d, power, e = dimensions, exponent, restitution
    alpha, beta = (1 - e * e) / 4 - (1 + e) ** 2 / (4 * d), (1 + e) * (3 - e) / 4
    mean_power = 2.0 ** (power + 2) * gamma((d + 2 + power) / 2) / gamma(d / 2)
    shape = alpha * (d + 2) * (2 + power) + beta * (2 * (d + 2) + 3 * power)
    return cross_section * sphere_area(d) * mean_power * shape / (8 * d * (d + 2))


def hard_sphere_relaxation(dimensions: int, cross_section: float, prandtl: float) -> float:
    """Coefficient of the ES-BGK rate tau = coefficient rho T^(1/2) that has the viscosity of hard spheres.

    First Sonine approximation: shear stress decays at the rate P/mu = Lambda rho T^(1/2) with Lambda = `shear_rate`,
    which is (64/5) sqrt(pi) b in d = 3 and (15/8) pi^(3/2) b = 10.44 b in d = 2; ES-BGK has mu = P Pr / tau, hence
    tau = Pr P/mu. One dimension has no shear: ValueError.
    """
    if dimensions == 1:
        raise ValueError("one velocity dimension has no viscosity to match")
    return prandtl * shear_rate(dimensions, cross_section)


def mean_speed(dimensions: int, temperature: np.ndarray) -> np.ndarray:
    """Mean of |v| in a Maxwellian at rest: sqrt(2 T) Gamma((d+1)/2) / Gamma(d/2)."""
    d = dimensions
    return np.sqrt(2 * temperature) * (gamma((d + 1) / 2) / gamma(d / 2))


def relaxation_rate(collision: Collision, density: np.ndarray, temperature: np.ndarray) -> np.ndarray:
    """tau(rho, T)/eps of the ES-BGK family."""
    law = collision.relaxation
    assert law is not None and collision.knudsen is not None
    return law.coefficient * density**law.density_power * temperature**law.temperature_power / collision.knudsen


def viscosity(collision: Collision, dimensions: int, density: np.ndarray, temperature: np.ndarray) -> np.ndarray:
    """mu of an elastic gas, in units of rho0 v0 L0; two or three velocity dimensions."""
    pressure = density * temperature
    if collision.relaxation is not None:
        assert collision.prandtl is not None
        return collision.prandtl * pressure / relaxation_rate(collision, density, temperature)
    assert collision.cross_section is not None and collision.exponent is not None and collision.knudsen is not None
    rate = shear_rate(dimensions, collision.cross_section, collision.exponent) / collision.knudsen
    return pressure / (rate * density * temperature ** (collision.exponent / 2))


def mean_free_path(collision: Collision, dimensions: int, density: np.ndarray, temperature: np.ndarray) -> np.ndarray:
    """Mean free path, in units of L0, of a gas of these densities and temperatures; see the module's docstring."""
    if dimensions > 1:
        mu = viscosity(collision, dimensions, density, temperature)
        return PATH_PER_VISCOSITY[dimensions] * mu / (density * np.sqrt(temperature))
    if collision.relaxation is not None:
        rate = relaxation_rate(collision, density, temperature)
    else:
        assert collision.cross_section is not None and collision.exponent is not None and collision.knudsen is not None
        power = collision.exponent
        relative = (4 * temperature) ** (power / 2) * gamma((1 + power) / 2) / gamma(0.5)
        rate = density * collision.cross_section * sphere_area(1) * relative / collision.knudsen
    return mean_speed(1, temperature) / rate


def collision_time(collision: Collision, dimensions: int, density: np.ndarray, temperature: np.ndarray) -> np.ndarray:
    """Mean free path over mean speed, in units of L0/v0."""
    return mean_free_path(collision, dimensions, density, temperature) / mean_speed(dimensions, temperature)


def cooling_power(collision: Collision) -> float:
    """r of the cooling rate -d ln T/dt = zeta = zeta0 rho T^r: half of the kernel's exponent, 1/2 for hard spheres."""
    return 0.5 if collision.exponent is None else collision.exponent / 2


def cooling_rate(collision: Collision, density: np.ndarray, temperature: np.ndarray) -> np.ndarray:
    """zeta = -d ln T/dt of a homogeneous Maxwellian gas, in units of v0/L0; 0 where collisions are elastic."""
    return 2 * collision.cooling * density * temperature ** cooling_power(collision)


def cooled(collision: Collision, density: float, temperature: float, time: float) -> float:
    """Temperature of a homogeneous gas after a time: Haff's law T (1 + r zeta t)^(-1/r), an exponential for r = 0."""
    rate = float(cooling_rate(collision, np.asarray(density), np.asarray(temperature)))
    power = cooling_power(collision)
    if power == 0.0:
        return temperature * float(np.exp(-rate * time))
    return temperature * float((1 + power * rate * time) ** (-1 / power))


def cooling_time(collision: Collision, density: float, temperature: float, factor: float = 4.0) -> float:
    """Time in which a homogeneous gas cools to so many times less by Haff's law; inf where it is elastic."""
    rate = float(cooling_rate(collision, np.asarray(density), np.asarray(temperature)))
    power = cooling_power(collision)
    if rate == 0.0:
        return float("inf")
    return float(np.log(factor)) / rate if power == 0.0 else (factor**power - 1) / (power * rate)
