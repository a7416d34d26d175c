"""The thermal scaling, v = u + omega xi: frames that move with the gas, transport between them, and how they turn.

    d_t g + div_x(v g) + div_xi(a g) = C[g],   a = -[(d_t u + v . grad u) + xi (d_t omega + v . grad omega)]/omega

u and omega = sqrt(T) are those of the carried moments: g has mean 0 and temperature 1. A frame is (u, omega), (..., 4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rvm_mpi.reference.collisions import cooling
from rvm_mpi.reference.drift import Turning
from rvm_mpi.reference.sides import mirrors, moving_side
from rvm_mpi.reference.state import (
    Array,
    Problem,
    State,
    face_value,
    mean_velocity,
    nodewise,
    powers,
    shifted,
    sums,
    temperature,
)
from rvm_mpi.reference.transport import Transport, face_values

#: the most that u changes between a cell's middle and its face, in units of omega
STEEPEST = 0.5


def frames(state: State) -> Array:
    """(ny, nx, 4): u and omega."""
    return np.concatenate([mean_velocity(state.U), state.omega[..., None]], axis=-1)


class Sight(NamedTuple):
    """What the gas of one side has on each face along an axis, the axis first: g, and its frame there."""

    g: Array
    frame: Array


def faces(p: Problem, state: State, axis: int) -> tuple[Sight, Sight]:
    """The gas below and the gas above each face.

    On a side that is no mirror what leaves has the frame of its cell, what enters that of `sides.moving_side`, which
    together with the extrapolated g also bounds the slopes of the cell inside.
    """
    g, w = np.moveaxis(state.g, 1 - axis, 0), np.moveaxis(frames(state), 1 - axis, 0)
    if p.job.space.periodic(axis):
        around = np.arange(-2, len(g) + 2) % len(g)
        return sights(g[around], w[around])
    low, high = moving_side(p, axis, 0, g, w), moving_side(p, axis, 1, g[::-1], w[::-1])
    cells = np.concatenate([low.g[::-1], g, high.g]), np.concatenate([low.frames[::-1], w, high.frames])
    below, above = sights(*cells)
    if not mirrors(p, axis, 0):
        below.g[0], below.frame[0], above.g[0], above.frame[0] = low.entering, low.frames[0], low.leaving, w[0]
    if not mirrors(p, axis, 1):
        below.g[-1], below.frame[-1], above.g[-1], above.frame[-1] = high.leaving, w[-1], high.entering, high.frames[0]
    return below, above


def sights(g: Array, w: Array) -> tuple[Sight, Sight]:
    """Both from cells with two ghosts: g node by node as ever, frames without room and no steeper than u may be."""
    sides = []
    for ahead, value in zip((1, -1), face_values(g)):
        own = w[1:-2] if ahead == 1 else w[2:-1]
        before, after = (w[:-3], w[2:-1]) if ahead == 1 else (w[3:], w[1:-2])
        step, most = face_value(own, own - before, after - own, 0.0) - own, STEEPEST * own[..., 3:]
        step[..., :3] = np.clip(step[..., :3], -most, most)
        sides.append(Sight(value, own + step))
    return sides[0], sides[1]


def moving_transport(p: Problem, state: State) -> Transport:
    """-div_x(v g): max(v-, 0) g- from below and min(v+, 0) g+ from above; `gradient` (d_x, 2, ny, nx, 4) of frames."""
    cells, space = state.omega.shape, p.job.space
    rate, N, courant = np.zeros(state.g.shape), np.zeros((*cells, 5)), np.zeros(cells)
    gradient = np.zeros((space.dimensions, 2, *cells, 4))
    for axis, dx in enumerate(space.spacing):
        fastest = []
        for end, (g, w) in enumerate(faces(p, state, axis)):
            v = nodewise(w[..., axis]) + nodewise(w[..., 3]) * p.xi[axis]
            flux = (np.maximum(v, 0.0) if end == 0 else np.minimum(v, 0.0)) * g / dx
            # of 1, v, |v|^2/2 from those of xi
            crossing = shifted(p.weight * sums(p, flux) * powers(w[..., 3]), w[..., :3])
            rate -= np.moveaxis(np.diff(flux, axis=0), 0, 1 - axis)
            N -= np.moveaxis(np.diff(crossing, axis=0), 0, 1 - axis)
            gradient[axis, end] = np.moveaxis(np.diff(w, axis=0), 0, 1 - axis) / dx
            fastest.append((np.abs(w[..., axis]), w[..., 3]))
        speed, thermal = np.max(fastest, axis=0)
        most = np.maximum(speed[:-1], speed[1:]) + np.maximum(thermal[:-1], thermal[1:]) * p.V[axis]
        courant += np.moveaxis(most, 0, 1 - axis) / dx
    return Transport(rate, N, gradient, courant)


class Rates(NamedTuple):
    """How a frame turns in a stage: alpha (..., 3) = d_t u/omega, beta = d_t ln omega, and omega's mean, which is L."""

    alpha: Array
    beta: Array
    L: Array


def change(p: Problem, U: Array, end: Array, dt: float, kept: Array | float = 1.0) -> Rates:
    """The rates that turn the frame of U into that of `end` over dt, `kept` the part of T that cooling left."""
    omega, ratio = np.sqrt(temperature(p, U)), np.sqrt(temperature(p, end) / kept / temperature(p, U))
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(np.abs(ratio - 1.0) < 1e-8, 0.5 * (1.0 + ratio), (ratio - 1.0) / np.log(ratio))
    L = omega * mean
    return Rates((mean_velocity(end) - mean_velocity(U)) / (dt * L)[..., None], np.log(ratio) / dt, L)


def rest(p: Problem, U: Array, middle: Array, end: Array, dt: float, first: Rates) -> Rates:
    """Rates of a second stage: those of the whole step, from U over `middle` to `end`, twice, less the first stage's.

    Cooling is left out, the drag cancels it: its part of the whole change is the mean of that by Haff's law forwards
    from U and of that backwards from `middle`.
    """
    ahead, behind = (cooling(p) * a[..., 0] * np.sqrt(temperature(p, a)) * dt for a in (U, middle))
    kept = (1.0 - behind) / (1.0 + ahead)
    whole = change(p, U, end, dt, kept)
    # u, which cooling leaves alone, is measured in the thermal speed that there was
    alpha = change(p, U, end, dt).alpha
    return Rates(2.0 * alpha - first.alpha, 2.0 * whole.beta - first.beta, whole.L * np.sqrt(kept))


def turning(p: Problem, state: State, rates: Rates, gradient: Array) -> Turning:
    """a = -[alpha + beta xi + sum_s v_s (P_s + xi P_omega,s)], P = grad(u, omega)/L, with the cell's own v."""
    flow = mean_velocity(state.U) / state.omega[..., None]
    P = gradient * (state.omega / rates.L)[..., None]
    none = np.zeros(flow.shape)
    return Turning(rates.beta, P[..., 3], -rates.alpha, none, 1.0 + none[..., 0], flow, P[..., :3])
