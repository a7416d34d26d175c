"""The Boltzmann operator by the direct sum over pairs of modes, and its penalisation."""

from __future__ import annotations

from functools import lru_cache
from math import gamma, sqrt

import numpy as np

from rvm_mpi.collisions.weights import SUPPORT, RadialIntegral, kernel_scale, pair_weights
from rvm_mpi.kinetic_theory import sphere_area
from rvm_mpi.reference.collisions import DEEPEST
from rvm_mpi.reference.gaussians import discrete_gaussian
from rvm_mpi.reference.state import Array, Problem, State, moments, nodewise, sums, temperature


@lru_cache(maxsize=8)
def pairs_of_modes(points: tuple[int, ...], restitution: float, exponent: float) -> tuple[Array, ...]:
    """l, m and k = l + m of all modes kept, as indices of spectra, W(l, m) symmetrised, and where each k begins."""
    most = np.array([(n - 1) // 2 for n in points])
    each = np.meshgrid(*(np.arange(-M, M + 1) for M in most), indexing="ij")
    modes = np.stack([axis.ravel() for axis in each], axis=-1)
    l, m = (a.ravel() for a in np.meshgrid(*[np.arange(len(modes))] * 2, indexing="ij"))  # noqa: E741
    inside = np.all(np.abs(modes[l] + modes[m]) <= most, axis=-1)
    l, m = l[inside], m[inside]  # noqa: E741
    k = modes[l] + modes[m]
    squares = [np.sum(a**2, axis=-1) for a in (k, modes[l], modes[m])]
    place = [np.ravel_multi_index(tuple((a % points).T), points) for a in (modes[l], modes[m], k)]
    order = np.lexsort((place[2], squares[0]))
    integral = RadialIntegral.create(len(points), exponent, max(1.0, sqrt(np.sum(most**2))))
    W = 0.5 * pair_weights(integral, restitution, *(s[order] for s in squares))
    begins = np.flatnonzero(np.diff(place[2][order], prepend=-1))
    return (*(a[order] for a in place), W, begins)


def boltzmann(p: Problem, state: State, rate: Array, slowing: Array) -> tuple[Array, Array]:
    """C[g] = omega^lambda Q(g, g)/eps less rate (M[g] - g), and the rate of f's energy with it.

    Q_k = sum over l + m = k of W(l, m) g_l g_m. Of the loss of energy an elastic gas has spectral error alone.
    """
    collision, points = p.job.collision, tuple(p.job.velocity.points)
    assert collision.knudsen and collision.cross_section and collision.exponent is not None
    restitution = 1.0 if collision.restitution is None else collision.restitution
    l, m, k, W, begins = pairs_of_modes(points, restitution, collision.exponent)  # noqa: E741
    axes = tuple(range(-p.d, 0))
    flat = state.g.reshape(*state.omega.shape, *points)
    spectrum = np.fft.fftn(flat, axes=axes, norm="forward").reshape(*state.omega.shape, -1)
    Q = np.zeros(spectrum.shape, dtype=complex)
    Q[..., k[begins]] = np.add.reduceat(W * spectrum[..., l] * spectrum[..., m], begins, axis=-1)
    Q = np.fft.ifftn(Q.reshape(flat.shape), axes=axes, norm="forward").real.reshape(state.g.shape)
    Q *= kernel_scale(p.d, p.V[0], collision.exponent, collision.cross_section)
    source = nodewise(slowing * state.omega**collision.exponent / collision.knudsen) * Q
    heating = np.zeros(state.omega.shape)
    for at in np.ndindex(*state.omega.shape):
        s = sums(p, state.g[at])
        u = s[1 : 1 + p.d] / s[0]
        T = (2.0 * s[4] / s[0] - np.sum(u**2)) / p.d
        if collision.penalise:
            source[at] -= rate[at] * (discrete_gaussian(p, s[0], u, T * np.eye(p.d)) - state.g[at])
        if not collision.elastic:
            square = sum((p.xi[q] - u[q]) ** 2 for q in range(p.d))
            heating[at] = 0.5 * p.weight * state.omega[at] ** 2 * np.sum(square * source[at])
    return source, heating


def penalisation(p: Problem, state: State, dt: float) -> tuple[Array, Array]:
    """The rate of the relaxation taken off the operator, fixed over a step, and what slows both where it is too deep.

    The mean rate of collisions, or half that of the fastest pair, 2 R apart.
    """
    collision = p.job.collision
    if not collision.penalise:
        return np.zeros(state.omega.shape), np.ones(state.omega.shape)
    assert collision.knudsen and collision.cross_section and collision.exponent is not None
    U, power = (state.U if p.job.scheme.conservative else moments(p, state)), collision.exponent
    rate = U[..., 0] * collision.cross_section * sphere_area(p.d) / collision.knudsen
    mean = (4.0 * temperature(p, U)) ** (power / 2) * gamma((p.d + power) / 2) / gamma(p.d / 2)
    rate = rate * np.maximum(mean, 0.5 * (2.0 * SUPPORT * p.V[0] * state.omega) ** power)
    taken = np.minimum(rate, DEEPEST / dt)
    return taken, taken / rate
