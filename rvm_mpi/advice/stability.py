"""Whether a cooling gas clusters: shear and heat modes of the homogeneous cooling state, from Navier and Stokes.

In a gas that cools by T' = -zeta T, zeta = zeta0 rho T^r, whose collisions take a shear stress away at the rate nu_s
and a heat flux at nu_q, both as T^q, the fluxes are those of Brey, Dufty, Kim and Santos (Phys. Rev. E 58, 1998)

    stress -2 eta S, eta = P/(nu_s - (1 - q) zeta),    heat flux -kappa grad T - mu grad rho,
    kappa = (d + 2)/2 P/(nu_q - (2 + r - q) zeta),     mu = kappa zeta T/rho / (nu_q - (2 - q) zeta),

in first Sonine order and without the fourth cumulant. A kernel |u|^lambda has r = q = lambda/2. Granular ES-BGK has
r = 1/2, nu_s = tau/Pr + zeta and nu_q = tau + 3/2 zeta, its drag included; this is exact for that model. Relative to
the gas's own thermal speed a shear wave then grows as zeta/2 - (eta/rho) k^2, and the heat mode, density against
temperature, is marginal where (2/(d rho)) (kappa - mu rho/T) k^2 = (1 - r) zeta (Garzo, Phys. Rev. E 72, 2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, log, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi import kinetic_theory

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job
    from rvm_mpi.job.schema import Collision

#: longitudinal waves that are looked at, from the longest on, and temperatures on the way to the end
WAVES, TEMPERATURES = 64, 33
#: of the start's temperature: what falls below is not followed
COLDEST = 1e-60


@dataclass(frozen=True)
class CoolingGas:
    """A homogeneous cooling gas with its transport coefficients; lengths, rates and speeds in the job's units."""

    dimensions: int
    density: float
    temperature: float
    power: float
    """r of the cooling rate."""
    cooling: float
    viscosity: float
    """eta; nought in one velocity dimension."""
    conductivity: float
    density_conductivity: float
    """mu of the heat flux -mu grad rho."""

    @classmethod
    def create(cls, collision: Collision, dimensions: int, density: float, temperature: float) -> CoolingGas | None:
        """The gas of these mean values; None where it is elastic, or cools too fast for its fluxes to follow.

        None as well for the Boltzmann operator in one velocity dimension, where elastic collisions relax nothing.
        """
        d, rho, t, knudsen = dimensions, density, temperature, collision.knudsen
        zeta = float(kinetic_theory.cooling_rate(collision, np.asarray(rho), np.asarray(t)))
        if zeta == 0.0 or knudsen is None or (d == 1 and collision.relaxation is None):
            return None
        r = kinetic_theory.cooling_power(collision)
        if collision.relaxation is not None:
            assert collision.prandtl is not None
            tau = float(kinetic_theory.relaxation_rate(collision, np.asarray(rho), np.asarray(t)))
            q, shear, heat = collision.relaxation.temperature_power, tau / collision.prandtl + zeta, tau + 1.5 * zeta
        else:
            assert collision.cross_section is not None and collision.restitution is not None
            q, kernel = r, (d, collision.cross_section, 2 * r, collision.restitution)
            grows = rho * t**q / knudsen
            shear, heat = (
                rate(*kernel) * grows for rate in (kinetic_theory.shear_rate, kinetic_theory.heat_flux_rate)
            )
        rates = shear - (1 - q) * zeta, heat - (2 + r - q) * zeta, heat - (2 - q) * zeta
        if min(rates) <= 0.0:
            return None
        kappa = (d + 2) / 2 * rho * t / rates[1]
        eta = rho * t / rates[0] if d > 1 else 0.0
        mu = kappa * zeta * t / rho / rates[2]
        sound = min(zeta, kappa) > 0.0 and isfinite(zeta + eta + kappa + mu) and kappa > mu * rho / t
        return cls(d, rho, t, r, zeta, eta, kappa, mu) if sound else None

    @property
    def shear_wavelength(self) -> float:
        """Shear waves longer than this grow relative to the thermal speed; inf without shear."""
        if self.viscosity == 0.0:
            return inf
        return 2 * pi * sqrt(2 * self.viscosity / (self.density * self.cooling))

    @property
    def heat_wavelength(self) -> float:
        """Heat modes longer than this grow; inf where none does."""
        conducted = self.conductivity - self.density_conductivity * self.density / self.temperature
        grows = self.dimensions * self.density * self.cooling * (1 - self.power) / 2
        return inf if grows <= 0.0 else 2 * pi * sqrt(conducted / grows)

    def shear_growth(self, k: np.ndarray) -> np.ndarray:
        """Rate at which a shear wave of wave number k (n,) grows relative to the thermal speed."""
        return 0.5 * self.cooling - self.viscosity / self.density * k**2

    def heat_growth(self, k: np.ndarray) -> np.ndarray:
        """Rate of the fastest mode of density, temperature and longitudinal velocity, in relative size, for k (n,)."""
        return np.asarray(np.linalg.eigvals(self.heat_matrix(k)).real.max(axis=-1))

    def heat_matrix(self, k: np.ndarray) -> np.ndarray:
        """Rates (n, 3, 3) of density, longitudinal velocity and temperature in relative size, for k (n,)."""
        d, c, zeta = self.dimensions, sqrt(self.temperature), self.cooling
        ik, square = 1j * k * c, k**2
        conducts = 2 / (d * self.density) * self.conductivity * square
        diffuses = 2 / (d * self.temperature) * self.density_conductivity * square
        matrix = np.zeros((len(k), 3, 3), dtype=complex)
        matrix[:, 0, 1] = matrix[:, 1, 0] = matrix[:, 1, 2] = -ik
        matrix[:, 1, 1] = zeta / 2 - 2 * (d - 1) / d * self.viscosity / self.density * square
        matrix[:, 2, 0], matrix[:, 2, 1] = -zeta - diffuses, -2 / d * ik
        matrix[:, 2, 2] = -self.power * zeta - conducts
        return matrix


@dataclass(frozen=True)
class Clustering:
    """How a periodic box of cooling gas stands to its critical wavelengths at the start.

    Attributes
    ----------
    shear, heat : float
        The box's longest side over the critical wavelength of each mode: above 1 the longest wave grows.
    folds : float
        e-foldings of the fastest wave that fits, in relative size, until the end of the run: 0 where none grows.
    wanted : float
        Time of three of them; inf where none grows.
    """

    shear: float
    heat: float
    folds: float
    wanted: float

    @property
    def stable(self) -> bool:
        """Whether all waves that fit into the box decay."""
        return max(self.shear, self.heat) <= 1.0


def clustering(job: Job, density: float, temperature: float) -> Clustering | None:
    """A granular gas of this mean state in a periodic box, by linear theory; None for other jobs.

    The critical wavelengths grow with the mean free path as the gas cools where they do not keep their ratio; the
    e-foldings are summed over the temperatures on the way, those of one wave.
    """
    d, space, collision = job.velocity.dimensions, job.space, job.collision
    if space.dimensions == 0 or not all(map(space.periodic, range(space.dimensions))):
        return None
    gas = CoolingGas.create(collision, d, density, temperature)
    if gas is None:
        return None
    longest = max(space.length)
    cells = space.cells[space.length.index(longest)]
    k = 2 * pi / longest * np.arange(1, min(cells // 2, WAVES) + 1)
    end = max(kinetic_theory.cooled(collision, density, temperature, job.time.end), COLDEST * temperature)
    folds, wanted = _folds(collision, d, density, np.geomspace(temperature, end, TEMPERATURES), k), inf
    ahead = _folds(collision, d, density, np.geomspace(temperature, 1e-12 * temperature, 10 * TEMPERATURES), k)
    if ahead[-1] > 3.0:
        factor = 10 ** float(np.interp(3.0, ahead, np.linspace(0, 12, len(ahead))))
        wanted = kinetic_theory.cooling_time(collision, density, temperature, factor)
    return Clustering(longest / gas.shear_wavelength, longest / gas.heat_wavelength, float(folds[-1]), wanted)


def _folds(collision: Collision, d: int, density: float, temperatures: np.ndarray, k: np.ndarray) -> np.ndarray:
    """e-foldings of the wave that grows most, from the first of falling temperatures to each: dt = -d ln T/zeta."""
    per_fall = []
    for temperature in temperatures:
        gas = CoolingGas.create(collision, d, density, float(temperature))
        if gas is None:
            per_fall.append(np.zeros(2 * len(k)))
        else:
            shear = gas.shear_growth(k) if d > 1 else np.full(len(k), -inf)
            per_fall.append(np.maximum(np.concatenate([shear, gas.heat_growth(k)]) / gas.cooling, 0.0))
    growth = np.array(per_fall)
    step = log(temperatures[0] / temperatures[1]) if len(temperatures) > 1 else 0.0
    sums = np.concatenate([np.zeros((1, growth.shape[1])), np.cumsum(0.5 * step * (growth[1:] + growth[:-1]), axis=0)])
    return np.asarray(np.maximum.accumulate(sums.max(axis=1)))
