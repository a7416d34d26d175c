"""Exact solution of the Riemann problem of the Euler equations for any gamma, vacuum included.

E. F. Toro, Riemann Solvers and Numerical Methods for Fluid Dynamics, chapter 4. A gas with d velocity
components has gamma = (d + 2)/d; its temperature is pressure over density.
"""

import numpy as np
from scipy.optimize import brentq


def gamma_of(d):
    return (d + 2) / d


def _wave(p, side, gamma):
    """Velocity lost across the wave on one side if the pressure behind it is p."""
    density, _velocity, pressure = side
    if p > pressure:
        a, b = 2 / ((gamma + 1) * density), (gamma - 1) / (gamma + 1) * pressure
        return (p - pressure) * np.sqrt(a / (p + b))
    sound = np.sqrt(gamma * pressure / density)
    return 2 * sound / (gamma - 1) * ((p / pressure) ** ((gamma - 1) / (2 * gamma)) - 1)


def middle(left, right, gamma):
    """Pressure and velocity between the two waves; (0, nan) if a vacuum opens."""
    sound = [np.sqrt(gamma * s[2] / s[0]) if s[0] > 0 else 0.0 for s in (left, right)]
    if min(left[0], right[0]) == 0 or 2 * sum(sound) / (gamma - 1) <= right[1] - left[1]:
        return 0.0, np.nan

    def residual(p):
        return _wave(p, left, gamma) + _wave(p, right, gamma) + right[1] - left[1]

    high = max(left[2], right[2])
    while residual(high) < 0:
        high *= 4
    p = brentq(residual, 0.0, high, xtol=1e-300, rtol=1e-14)
    return p, 0.5 * (left[1] + right[1] + _wave(p, right, gamma) - _wave(p, left, gamma))


def _half(side, p, u, s, gamma):
    """Solution on the left of the contact, for speeds s = x/t; arrays of density, velocity, pressure."""
    density, velocity, pressure = side
    s = np.asarray(s, dtype=float)
    if density == 0:
        return np.zeros_like(s), np.zeros_like(s), np.zeros_like(s)
    sound = np.sqrt(gamma * pressure / density)
    ratio = (gamma - 1) / (gamma + 1)
    if p > pressure:
        mach2 = (gamma + 1) / (2 * gamma) * p / pressure + (gamma - 1) / (2 * gamma)
        speed = velocity - sound * np.sqrt(mach2)
        behind = (density * (p / pressure + ratio) / (ratio * p / pressure + 1), u, p)
        return tuple(np.where(s < speed, a, b) for a, b in zip(side, behind, strict=True))
    fan = 2 / (gamma + 1) + ratio / sound * (velocity - s)
    fan = np.maximum(fan, 0.0)
    values = (
        density * fan ** (2 / (gamma - 1)),
        2 / (gamma + 1) * (sound + (gamma - 1) / 2 * velocity + s),
        pressure * fan ** (2 * gamma / (gamma - 1)),
    )
    if p > 0:
        behind = (density * (p / pressure) ** (1 / gamma), u, p)
        tail = u - sound * (p / pressure) ** ((gamma - 1) / (2 * gamma))
    else:
        behind, tail = (0.0, 0.0, 0.0), velocity + 2 * sound / (gamma - 1)
    return tuple(
        np.where(s < velocity - sound, a, np.where(s < tail, f, b))
        for a, f, b in zip(side, values, behind, strict=True)
    )


def riemann(left, right, speeds, gamma):
    """Density, velocity and pressure at x/t = speeds.

    Parameters
    ----------
    left, right : (density, velocity, pressure)
        A density of zero is a vacuum.
    speeds : array
        x/t, the jump at x = 0.
    gamma : float

    Returns
    -------
    tuple of three arrays like `speeds`
        In a vacuum all three are zero.
    """
    s = np.asarray(speeds, dtype=float)
    p, u = middle(left, right, gamma)
    from_left = _half(left, p, u, s, gamma)
    mirrored = _half((right[0], -right[1], right[2]), p, -u, -s, gamma)
    from_right = (mirrored[0], -mirrored[1], mirrored[2])
    if p > 0:
        return tuple(np.where(s < u, a, b) for a, b in zip(from_left, from_right, strict=True))
    # with a vacuum between them the two sides do not overlap, and each is zero where the other is not
    return tuple(a + b for a, b in zip(from_left, from_right, strict=True))


def cell_averages(left, right, time, edges, position, gamma, points=20):
    """Averages of density, velocity and pressure over cells, by the midpoint rule at `points` points each."""
    edges = np.asarray(edges)
    offsets = (np.arange(points) + 0.5) / points
    x = edges[:-1, None] + offsets * np.diff(edges)[:, None]
    return tuple(v.mean(axis=1) for v in riemann(left, right, (x - position) / time, gamma))
