"""Small waves in a cooling granular gas near Navier and Stokes: which grow beside the cooling, and how much.

For granular ES-BGK, mass 1. With beta = C rho sqrt(T)/eps, half the rate at which T falls, and r = tau/eps the rate of
relaxation, the first order of Chapman and Enskog about the homogeneous cooling state (a Maxwellian in this model) is

    stress     mu = p/(r/Pr + beta)
    heat flux q = - kappa grad T - kappa_n grad rho, kappa = (d + 2)/2 p/(r - beta), kappa_n = 2 beta kappa T/(rho r)

as Brey, Dufty, Kim and Santos, Phys. Rev. E 58, 4638 (1998), have it for hard spheres, with this model's own rates.
tau must go as rho sqrt(T): then all rates fall together, and in the clock ds = beta dt, s = ln(1 + beta(0) t), the
waves of delta rho/rho, u/sqrt(T) and delta T/T have constant coefficients. In that clock

    shear      d w/ds = (1 - (k/k_s)^2) w,   k_s^2 = beta rho/mu
    density    grows slowly where k < k_h,   k_h^2 = d beta rho/(2 (kappa - kappa_n rho/T))

T's own mean falls as exp(-2 s): a wave of the velocity that "grows" does so beside sqrt(T).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log1p, pi, sqrt

import numpy as np

from rvm_mpi import Job


@dataclass(frozen=True)
class CoolingGas:
    """Rates and transport coefficients of the homogeneous gas at the start, the Knudsen number in them.

    Attributes
    ----------
    dimensions : int
        Of velocity, d.
    density, temperature : float
    cooling, relaxation : float
        beta and r.
    viscosity, conductivity, dufour : float
        mu, kappa, kappa_n.
    """

    dimensions: int
    density: float
    temperature: float
    cooling: float
    relaxation: float
    viscosity: float
    conductivity: float
    dufour: float

    @classmethod
    def of(cls, job: Job, density: float, temperature: float = 1.0) -> CoolingGas:
        """The gas of a job with the granular ES-BGK operator and tau ~ rho sqrt(T)."""
        collision, d = job.collision, job.velocity.dimensions
        law = collision.relaxation
        assert (law.density_power, law.temperature_power) == (1, 0.5)
        beta = collision.cooling * density * sqrt(temperature)
        r = law.coefficient * density * sqrt(temperature) / collision.knudsen
        pressure = density * temperature
        kappa = (d + 2) / 2 * pressure / (r - beta)
        return cls(
            dimensions=d,
            density=density,
            temperature=temperature,
            cooling=beta,
            relaxation=r,
            viscosity=pressure / (r / collision.prandtl + beta),
            conductivity=kappa,
            dufour=2 * beta * kappa * temperature / (density * r),
        )

    def clock(self, time: float) -> float:
        """s = ln(1 + beta t) = ln sqrt(T(0)/T(t))."""
        return log1p(self.cooling * time)

    @property
    def shear(self) -> float:
        """k_s, above which shear decays beside the cooling."""
        return sqrt(self.cooling * self.density / self.viscosity)

    @property
    def clustering(self) -> float:
        """k_h, above which the slow mode of the density decays."""
        effective = self.conductivity - self.dufour * self.density / self.temperature
        return sqrt(self.dimensions * self.cooling * self.density / (2 * effective))

    def shear_rate(self, k: float) -> float:
        """Growth of u/sqrt(T) across k in s."""
        return 1 - (k / self.shear) ** 2

    def matrix(self, k: float) -> np.ndarray:
        """d/ds of (delta rho/rho, w, delta T/T), the velocity along k being i w sqrt(T); shape (3, 3)."""
        d, rho, temperature, beta = self.dimensions, self.density, self.temperature, self.cooling
        streaming = k * sqrt(temperature)
        conduction = 2 * k**2 / (d * rho)
        rates = [
            [0.0, streaming, 0.0],
            [-streaming, beta - 2 * (d - 1) / d * self.viscosity * k**2 / rho, -streaming],
            [
                -2 * beta - conduction * self.dufour * rho / temperature,
                2 / d * streaming,
                -beta - conduction * self.conductivity,
            ],
        ]
        return np.array(rates) / beta

    def slow_rate(self, k: float) -> float:
        """Growth of the mode in which the density clusters, in s: the largest real part of the three."""
        return float(np.linalg.eigvals(self.matrix(k)).real.max())


def box_row(job: Job, density: float) -> tuple[float, ...]:
    """Mean free paths in the box, box over both critical lengths, s at the end, e-foldings of shear and density.

    The box is the shortest side of a periodic domain, the mean free path eps/(sqrt(2) pi rho) that of hard spheres of
    unit diameter, the growth that of the longest wave in the box.
    """
    gas, length = CoolingGas.of(job, density), min(job.space.length)
    k, s = 2 * pi / length, CoolingGas.of(job, density).clock(job.time.end)
    free_paths = length * sqrt(2) * pi * density / job.collision.knudsen
    return free_paths, gas.shear / k, gas.clustering / k, s, s * gas.shear_rate(k), s * gas.slow_rate(k)
