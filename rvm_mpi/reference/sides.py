"""What lies beyond the sides of the domain: two ghost cells of g and of omega."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from rvm_mpi.reference.gaussians import ROOM, axis_gaussian, least_variance
from rvm_mpi.reference.state import Array, Problem, State, face_value, nodewise, sums

#: a box of so many thermal speeds on either side holds a Gaussian; so many h^2 of variance are held anywhere
REACH, HELD_ANYWHERE = 3.5, 0.27
#: variances that differ by less than this are the same
ROUNDED = 1e-9
#: least variance of a side's state in the inner cell's moving frame, and the farthest its mean may lie, in omega
COLDEST, FARTHEST = 0.3, 2.0


class Ghosts(NamedTuple):
    """Cells beyond a side, (n, px, py, pz), the near and the far ones.

    beyond (n, 5): mass, momentum and energy through the faces, along the axis, that no node says; mirrored: whether
    omega is that of the two inner cells like g, else that of the inner one.
    """

    near: Array
    far: Array
    beyond: Array
    mirrored: bool


def with_ghosts(p: Problem, state: State, axis: int) -> tuple[Array, Array, list[Array]]:
    """g and omega with two ghost cells on either side, the axis first, and `Ghosts.beyond` of both sides."""
    g, omega = np.moveaxis(state.g, 1 - axis, 0), np.moveaxis(state.omega, 1 - axis, 0)
    if p.job.space.periodic(axis):
        around = np.arange(-2, len(g) + 2) % len(g)
        return g[around], omega[around], [np.zeros((g.shape[1], 5))] * 2
    low, high = ghosts(p, axis, 0, g, omega), ghosts(p, axis, 1, g[::-1], omega[::-1])
    return (
        np.concatenate([[low.far, low.near], g, [high.near, high.far]]),
        np.concatenate([omega_beyond(p, low, omega)[::-1], omega, omega_beyond(p, high, omega[::-1])]),
        [low.beyond, high.beyond],
    )


def omega_beyond(p: Problem, side: Ghosts, omega: Array) -> Array:
    """omega of the near and the far ghost cell: that on the face is then the inner cell's, as either side sees it."""
    if side.mirrored or not p.job.scheme.conservative:
        return omega[[0, 1 if side.mirrored else 0]]
    half = 0.5 * (omega[1] - omega[0])
    return np.stack([omega[0] + half, omega[0] + 5.0 * half])


def side_of(p: Problem, axis: int, end: int) -> Any:
    """A side as the job has it."""
    return p.job.space.sides["xy"[axis] + ("-lower", "-upper")[end]]


def mirrors(p: Problem, axis: int, end: int) -> bool:
    """Whether a side sends back all that arrives, mirrored."""
    side = side_of(p, axis, end)
    return side.kind == "specular" or (side.kind == "maxwell" and not side.accommodation)


def ghosts(p: Problem, axis: int, end: int, g: Array, omega: Array) -> Ghosts:
    """Ghost cells of one side from the cells inward, g (cells, n, px, py, pz) and omega (cells, n)."""
    side, sign = side_of(p, axis, end), 1 - 2 * end
    inner, beyond, across = g[0], np.zeros((g.shape[1], 5)), axis - 3
    accommodation = side.accommodation or 0.0
    if mirrors(p, axis, end):
        return Ghosts(np.flip(inner, across), np.flip(g[1], across), beyond, True)
    if side.kind == "outflow":
        return Ghosts(inner, inner, beyond, False)
    # what leaves sees the extrapolated gas, half of that inside at least; what enters sees what the side sends
    speed = sign * p.xi[axis] * np.ones(inner.shape[1:])
    enters, extrapolated = speed > 0.0, np.maximum(2.0 * inner - g[1], 0.5 * inner)
    leaving, incoming = face_value(inner, inner - g[1], extrapolated - inner), np.zeros(inner.shape)
    for c in range(len(inner)) if side.kind in ("maxwell", "far-field") else ():
        incoming[c], lack = maxwellian_entering(p, axis, sign, p.sides[axis, end][c], inner[c], omega[0, c])
        if side.kind == "maxwell":  # as much mass as leaves, counted with its sign
            lost = -np.sum((speed * leaving[c])[~enters])
            incoming[c] *= accommodation * lost / np.sum((speed * incoming[c])[enters])
        J = p.weight * omega[0, c] * np.sum((speed * incoming[c])[enters])
        if p.carries:  # momentum along the normal counts the same whichever way the axis points
            beyond[c] = J * lack * np.where(np.arange(5) == 1 + axis, 1.0, sign)
        if side.kind == "maxwell":
            incoming[c] += (1.0 - accommodation) * np.flip(leaving[c], across)
    value = np.where(enters, incoming, extrapolated)
    # where it enters, differences as 1 to -2 make the face's value the near cell's
    return Ghosts(value, 2.0 * inner - value, beyond, False)


def maxwellian_entering(
    p: Problem, axis: int, sign: int, side: Array, inner: Array, omega: float
) -> tuple[Array, Array]:
    """The Maxwellian (px, py, pz) of a side's rho, u, T in the inner cell's omega, and what U through the face lacks.

    Where the nodes cannot hold it they take the nearest they can, with the side's mass flux; `lack` (5) is momentum and
    energy per mass that the side's own half-space has beyond theirs, for the carried moments alone.
    """
    s = sums(p, inner)
    own = (2.0 * s[4] / s[0] - np.sum((s[1:4] / s[0]) ** 2)) / p.d
    mean, variance = side[1:4] / omega, side[4] / omega**2
    factors, lack, energy = [np.ones(1)] * 3, np.zeros(5), 0.0
    for q in range(p.d):
        x, h = p.xi[q].ravel(), p.h[q]
        centre = np.clip(mean[q], 0.25 * h - x[-1], x[-1] - 0.25 * h)
        held = min(variance, max(own, (p.V[q] / REACH) ** 2))
        factors[q] = axis_gaussian(x, centre, max(held, least_variance(x, centre) + ROOM * h**2))
        if q != axis:
            lack[1 + q] = omega * (mean[q] - np.sum(x * factors[q]))
            energy += mean[q] ** 2 + variance - np.sum(x**2 * factors[q])
    # along the normal it is the half-space of the side's Gaussian in a frame s omega whose nodes hold it
    x, u, normal = p.xi[axis].ravel(), mean[axis], factors[axis]
    scale = frame(p, axis, u, variance, own, sqrt(variance + np.sum(mean**2) / p.d))
    whole = normal if scale == 1.0 else axis_gaussian(x, u / scale, variance / scale**2)
    c, enters = sign * x, sign * x > 0.0
    (n1, n2, n3), (w1, w2, w3) = ([np.sum((c**k * f)[enters]) for k in (1, 2, 3)] for f in (normal, whole))
    if not (n1 > 0.0 and w1 > 0.0):  # all of the gas flows out
        return np.zeros(inner.shape), np.zeros(5)
    lack[1 + axis] = omega * (scale * w2 / w1 - n2 / n1)
    lack[4] = 0.5 * omega**2 * (energy + scale**2 * w3 / w1 - n3 / n1)
    product = factors[0][:, None, None] * factors[1][:, None] * factors[2]
    return side[0] / p.weight * scale * w1 / n1 * product, lack


def frame(p: Problem, axis: int, mean: float, variance: float, own: float, side: float) -> float:
    """s of the frame s omega in which the nodes along the normal hold a side's mean and variance.

    own: T_g of the inner cell, which counts as held, as does a variance of h^2; side: the side's own omega over the
    inner cell's.
    """
    x, h = p.xi[axis].ravel(), p.h[axis]
    least, widest = min(own, h**2), max(own, (p.V[axis] / REACH) ** 2)
    floor = least_variance(x, mean) + ROOM * (1.0 - ROUNDED) * h**2
    if abs(mean) < x[-1] and variance >= floor and least * (1.0 - ROUNDED) <= variance <= widest * (1.0 + ROUNDED):
        return 1.0
    scale = sqrt(variance / (widest if variance > widest else max(least, HELD_ANYWHERE * h**2)))
    return scale if abs(mean) < 0.5 * x[-1] * scale else max(scale, side)


class Moving(NamedTuple):
    """Beyond a side in the thermal scaling: g and frames of the near and the far ghost cell, (2, n, ...).

    leaving, entering: g on the face of what leaves, in the inner cell's frame, and of what enters, in the near one's.
    """

    g: Array
    frames: Array
    leaving: Array
    entering: Array


def moving_side(p: Problem, axis: int, end: int, g: Array, frames: Array) -> Moving:
    """What one side does, from the cells inward: g (cells, n, px, py, pz) and their frames u, omega (cells, n, 4)."""
    side, sign, across = side_of(p, axis, end), 1 - 2 * end, axis - 3
    inner, w, reflected = g[0], frames[0], frames * np.where(np.arange(4) == axis, -1.0, 1.0)
    if mirrors(p, axis, end):
        return Moving(np.flip(g[:2], across), reflected[:2], inner, inner)
    beyond = np.maximum(2.0 * inner - g[1], 0.5 * inner)
    leaving = face_value(inner, inner - g[1], beyond - inner)
    wall, entering = side.kind == "maxwell", inner if side.kind == "outflow" else np.zeros(inner.shape)
    if wall or side.kind == "far-field":
        there = p.sides[axis, end]
        w = frame_of_side(p, axis, there, reflected[0] if wall else w, not wall or side.accommodation == 1.0)
        entering = there[:, 0, None, None, None] / p.weight * np.array([shape(p, *pair) for pair in zip(there, w)])
    if wall:  # as much mass comes back as arrives
        arrives, comes = (
            np.einsum("nijk->n", np.maximum(s * sign * normal_speed(p, axis, frame), 0.0) * values)
            for s, frame, values in ((-1, frames[0], leaving), (1, w, entering))
        )
        entering = nodewise(side.accommodation * arrives / comes) * entering
        entering = entering + (1.0 - side.accommodation) * np.flip(leaving, across)
    return Moving(np.stack([beyond, beyond]), np.stack([w, w]), leaving, entering)


def normal_speed(p: Problem, axis: int, frames: Array) -> Array:
    """v along an axis of the nodes of frames (n, 4)."""
    return nodewise(frames[:, axis]) + nodewise(frames[:, 3]) * p.xi[axis]


def frame_of_side(p: Problem, axis: int, side: Array, frames: Array, may: bool) -> Array:
    """The frames (n, 4) given, or a side's own, (n, 5) rho, u, T, where it may and theirs cannot hold its state."""
    own = np.concatenate([side[:, 1:4], np.sqrt(side[:, 4:])], axis=-1)
    variance = side[:, 4] / frames[:, 3] ** 2
    away = np.sqrt(np.sum((side[:, 1:4] - frames[:, :3]) ** 2, axis=-1)) > FARTHEST * frames[:, 3]
    unfit = away | (variance < COLDEST) | (variance > (p.V[axis] / REACH) ** 2)
    return np.where((may & unfit)[:, None], own, frames)


def shape(p: Problem, side: Array, frame: Array) -> Array:
    """The discrete Maxwellian (px, py, pz), of sum one, of a side's u and T on the nodes of a frame."""
    factors = [np.ones(1)] * 3
    for q in range(p.d):
        factors[q] = axis_gaussian(p.xi[q].ravel(), (side[1 + q] - frame[q]) / frame[3], side[4] / frame[3] ** 2)
    return factors[0][:, None, None] * factors[1][:, None] * factors[2]
