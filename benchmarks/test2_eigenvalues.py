"""Test 2 by linear theory: how fast a wave of density decays in log t and with what period, about a cooling gas.

`python benchmarks/test2_eigenvalues.py` (half a minute). One space and one velocity dimension, hard spheres, b = 1,
density one. The homogeneous cooling state is f = g(v/omega)/omega with

    zeta (xi g)' = Q(g, g),   <xi^2> = 1,   d omega/dt = -zeta omega^2/eps,   so   omega = eps/(zeta (t + t_0)).

A wave h exp(i k x) of the scaled gas then obeys, with s = log(t + t_0), what does not depend on s,

    dh/ds = -i k (eps/zeta) xi h - (xi h)' + (Q(g, h) + Q(h, g))/zeta,

so that density goes as t^lambda: damping Re lambda, period 2 pi/Im lambda in log t, half of it for the norm L(t).
Q is the spectral operator, its bilinear form exact from Q(g + h) - Q(g - h); derivatives are Fourier's; outside the
operator's support, where nothing collides, a sponge takes away what drifts out. h has fine structure in xi, which
nearly elastic collisions in one dimension, an exchange of velocities, hardly damp: hence many points. What two grids do
not have in common is no mode of the gas and is left out.

Beside the eigenvalues, the same equations in time from a gas at rest of temperature one with a wave of density, as
Test 2 starts: the scaled state g changes from a Gaussian, t is the run's own.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi.collisions.boltzmann import BoltzmannOperator

RESTITUTIONS = (0.8, 0.85, 0.9, 0.95)
PAPER = {0.8: -1.05, 0.85: -1.4, 0.9: -2.05, 0.95: -4.1}
KNUDSEN = 0.1


class CoolingGas:
    """The homogeneous cooling state in one velocity dimension, and the operators linearised about it."""

    def __init__(self, restitution, points=128, half_width=9.0, inner=0.6, coarse=None):
        self.operator = BoltzmannOperator.create((points,), half_width, restitution)
        self.h = 2 * half_width / points
        x = self.x = (np.arange(points) + 0.5) * self.h - half_width
        waves = np.fft.fftfreq(points, 1 / points) * np.pi / half_width
        waves[points // 2] = 0.0
        derivative = np.fft.ifft(1j * waves[:, None] * np.fft.fft(np.eye(points), axis=0), axis=0).real
        self.spread = derivative * x
        self.sponge = np.minimum(10 * (np.abs(x) / (inner * half_width)) ** 24, 40.0)
        self.g, self.zeta = self._stationary(coarse)

    def collide(self, g):
        """Q(g, g), of one or of many."""
        g = np.ascontiguousarray(np.atleast_2d(g))
        out = np.empty_like(g)
        self.operator.collide(g, out)
        return out

    def collide_with(self, g):
        """Matrix of h -> Q(g, h) + Q(h, g)."""
        unit = np.eye(len(g)) * np.abs(g).max()
        return (self.collide(g + unit) - self.collide(g - unit)).T / (2 * np.abs(g).max())

    def _stationary(self, coarse):
        """Newton's steps for g and zeta together, from a Gaussian or from the state on a coarser grid."""
        x, h = self.x, self.h
        if coarse is None:
            g, zeta = self._relaxed()
        else:
            g, zeta = CubicSpline(coarse.x, coarse.g)(x), coarse.zeta
        for _ in range(20):
            rest = self.collide(g)[0] - zeta * (self.spread @ g) - self.sponge * g
            matrix = self.collide_with(g) - zeta * self.spread - np.diag(self.sponge)
            # mass and temperature one, and zeta unknown: two more rows, by least squares
            system = np.zeros((len(g) + 2, len(g) + 1))
            system[:-2, :-1], system[:-2, -1] = matrix, -(self.spread @ g)
            system[-2, :-1], system[-1, :-1] = h, x**2 * h
            wanted = np.concatenate([-rest, [1 - g.sum() * h, 1 - (x**2 * g).sum() * h]])
            change = np.linalg.lstsq(system, wanted, rcond=1e-12)[0]
            g, zeta = g + change[:-1], zeta + change[-1]
            if np.abs(change).max() < 1e-12:
                break
        self.residual = np.abs(rest).max()
        return 0.5 * (g + g[::-1]), zeta

    def _relaxed(self):
        """Steps of Runge and Kutta towards the state."""
        x, h, step = self.x, self.h, 0.05
        g = np.exp(-(x**2) / 2)
        g /= g.sum() * h
        for _ in range(4000):
            start, stage, total = g, g, 0.0
            for part, weight in ((0.5, 1 / 6), (0.5, 1 / 3), (1.0, 1 / 3), (0.0, 1 / 6)):
                q = self.collide(stage)[0]
                zeta = -(x**2 * q).sum() / (2 * (x**2 * stage).sum())
                rate = q - zeta * (self.spread @ stage)
                total = total + weight * rate
                stage = start + part * step * rate
            g = (start + step * total) * np.exp(-step * self.sponge)
            g = (g + g[::-1]) / (2 * h * g.sum())
            excess = (x**2 * g).sum() * h - 1
            g *= 1 - excess * (x**2 - 1) / ((x**4 * g).sum() * h - 1)
        return g, zeta

    def cumulant(self):
        """a_2 = <xi^4>/3 - 1."""
        return (self.x**4 * self.g).sum() * self.h / 3 - 1

    def generator(self, wave):
        """Matrix of d/ds for a wave number."""
        transport = -1j * wave * KNUDSEN / self.zeta * self.x
        return np.diag(transport - self.sponge) - self.spread + self.collide_with(self.g) / self.zeta

    def eigenvalues(self, wave, count):
        """The least damped eigenvalues with Im >= 0."""
        values = np.linalg.eigvals(self.generator(wave))
        values = values[values.imag > -1e-6]
        return values[np.argsort(-values.real)][:count]


def decay(gas, wave, end):
    """Times and the amplitude of density of a wave that is one at the start, on a Maxwellian gas of temperature one.

    The scaled gas keeps temperature one; with d tau = omega dt/eps

        dg/dtau = Q(g, g) - zeta(g) (xi g)',   dh/dtau = Q(g, h) + Q(h, g) - zeta(g) (xi h)' - i k eps xi h.
    """
    x, h = gas.x, gas.h
    g = np.exp(-(x**2) / 2) / (2 * np.pi) ** 0.5
    state = np.concatenate([g.astype(complex), g.astype(complex), [0.0, 0.0]])
    n = len(x)

    def rate(y):
        """d/dtau of g, h, log omega and t."""
        g, w = y[:n].real, y[n : 2 * n]
        omega = np.exp(y[2 * n].real)
        both = gas.collide(np.stack([g + w.real, g - w.real, g + w.imag, g - w.imag, g]))
        q = both[4]
        zeta = -(x**2 * q).sum() / (2 * (x**2 * g).sum())
        linear = 0.5 * (both[0] - both[1]) + 0.5j * (both[2] - both[3])
        by_g = q - zeta * (gas.spread @ g) - gas.sponge * g
        by_h = linear - zeta * (gas.spread @ w) - gas.sponge * w - 1j * wave * KNUDSEN * x * w
        return np.concatenate([by_g, by_h, [-zeta, KNUDSEN / omega]])

    times, density = [], []
    step = 0.02
    while state[-1].real < end:
        total, stage = 0.0, state
        for part, weight in ((0.5, 1 / 6), (0.5, 1 / 3), (1.0, 1 / 3), (0.0, 1 / 6)):
            change = rate(stage)
            total = total + weight * change
            stage = state + part * step * change
        state = state + step * total
        times.append(state[-1].real)
        density.append(state[n : 2 * n].sum().real * h)
    return np.array(times), np.array(density)


def peaks(times, density):
    """log t of the maxima of |density|, and its logarithm there, each by a parabola."""
    s, size = np.log(times), np.log(np.abs(density))
    at, top = [], []
    for i in range(1, len(s) - 1):
        if size[i] > size[i - 1] and size[i] >= size[i + 1] and abs(density[i]) > 1e-7:
            a, b, _ = np.polyfit(s[i - 1 : i + 2] - s[i], size[i - 1 : i + 2] - size[i], 2)
            at.append(s[i] - b / (2 * a))
            top.append(size[i] - b * b / (4 * a))
    return np.array(at), np.array(top)


def common(values, others, tolerance=2e-3):
    """Those of the values that the others have, too."""
    return np.array([v for v in values if np.abs(others - v).min() < tolerance])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, nargs=2, default=(384, 512))
    parser.add_argument("--half-width", type=float, default=9.0)
    given = parser.parse_args()
    print(f"{given.points} points, V = {given.half_width}, eps = {KNUDSEN}")
    for e in RESTITUTIONS:
        coarse = CoolingGas(e, 128, given.half_width)
        one, two = (CoolingGas(e, n, given.half_width, coarse=coarse) for n in given.points)
        gaussian = (1 - e**2) / np.pi**0.5
        print(f"e = {e}: zeta {two.zeta:.6f}, {two.zeta / gaussian:.4f} of a Gaussian's, a_2 {two.cumulant():.4f}")
        for name, wave in (("pi, specular", np.pi), ("2 pi, periodic", 2 * np.pi)):
            print(f"  k = {name}" + (f", the paper's damping {PAPER[e]}" if wave == np.pi else ""))
            for v in common(one.eigenvalues(wave, 40), two.eigenvalues(wave, 40))[:4]:
                period = f", period {2 * np.pi / v.imag:.3f}, of L {np.pi / v.imag:.3f}" if v.imag > 1e-3 else ""
                print(f"    lambda {v.real:.4f}" + (f" +- {v.imag:.4f} i" if period else "") + period)
            at, top = peaks(*decay(coarse, wave, 60.0))
            print("    from a Maxwellian, maxima of L at log t = " + ", ".join(f"{s:.2f}" for s in at))
            print("    and the slopes between them " + ", ".join(f"{s:.2f}" for s in np.diff(top) / np.diff(at)))


if __name__ == "__main__":
    main()
