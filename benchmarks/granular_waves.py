"""Small waves in a cooling granular gas, 1V, linear: what Test 2 should show, without its grid in space and its drift.

    f = f0(t, v) + Re h(t, v) exp(i k x),   d_t h + i k v h = 2 Q(f0, h)/eps

about the homogeneous gas f0 as it cools from a Maxwellian, both in rescaled velocities and the clock ds = omega dt;
drift by Fourier series, Runge-Kutta 4. `test2_eigenvalues.py` has the modes about the homogeneous cooling state.

    python benchmarks/granular_waves.py                 (a minute)
"""

import sys
from math import pi
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi.collisions.boltzmann import BoltzmannOperator

PAPER = {0.8: -1.05, 0.85: -1.4, 0.9: -2.05, 0.95: -4.1}


class Wave:
    """f0 and h of a wave of wave number k on the nodes of a velocity grid."""

    def __init__(self, e, k, knudsen=0.1, points=192, half_width=10.0):
        self.operator = BoltzmannOperator.create((points,), half_width, e, 1.0, 1.0)
        self.knudsen, self.k = knudsen, k
        self.spacing = 2 * half_width / points
        self.xi = (np.arange(points) + 0.5) * self.spacing - half_width
        self._modes = 2j * pi * np.fft.rfftfreq(points, self.spacing)
        self._modes[-1] = 0.0

    def divergence(self, g):
        """d(xi g)/dxi."""
        return np.fft.irfft(self._modes * np.fft.rfft(self.xi * g), n=self.xi.size)

    def rates(self, g, re, im):
        """d/ds of g0 and of h, and the cooling rate -d ln omega/ds."""
        cells = np.stack([g, g + re, g - re, g + im, g - im])
        q = np.empty_like(cells)
        self.operator.collide(cells, q)
        q /= self.knudsen
        cooling = -0.5 * (self.xi**2 @ q[0]) / (self.xi**2 @ g)
        return (
            q[0] - cooling * self.divergence(g),
            0.5 * (q[1] - q[2]) - cooling * self.divergence(re) + self.k * self.xi * im,
            0.5 * (q[3] - q[4]) - cooling * self.divergence(im) - self.k * self.xi * re,
            cooling,
        )

    def evolve(self, end, ds=0.005, amplitude=0.1):
        """t, T and amplitude of the density from a Maxwellian with a wave in the density alone, to the time `end`."""
        g = np.exp(-self.xi**2 / 2)
        g /= g.sum() * self.spacing
        state = [g, amplitude * g, 0 * g]
        time, log_omega, rows = 0.0, 0.0, []
        while time < end:
            rows.append((time, np.exp(2 * log_omega), state[1].sum() * self.spacing))
            sums, slopes = [0.0, 0.0, 0.0, 0.0], (0.0, 0.0, 0.0)
            for weight, step in ((1, 0.0), (2, 0.5), (2, 0.5), (1, 1.0)):
                slopes = self.rates(*(s + step * ds * q for s, q in zip(state, slopes)))
                sums = [a + weight * b for a, b in zip(sums, slopes)]
            state = [s + ds / 6 * q for s, q in zip(state, sums)]
            # dt = ds/omega, omega = omega0 exp(-c s) within the step
            c = sums[3] / 6
            time += np.exp(-log_omega) * np.expm1(c * ds) / c
            log_omega -= c * ds
        return np.array(rows).T


def main() -> None:
    for e, paper in PAPER.items():
        wave = Wave(e, pi)
        time, _temperature, density = wave.evolve(30.0)
        for t in (0.5, 1, 2, 5, 10, 20):
            print(f"e = {e}, t = {t}: L = {2 / pi * abs(np.interp(t, time, density)):.3e}", end="; ")
        print(f"\n  paper's damping {paper}")


if __name__ == "__main__":
    main()
