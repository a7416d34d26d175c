"""div_xi(a g): the total drift in velocity space, of the scaling and of the drag."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rvm_mpi.reference.state import Array, Problem, half_slope, nodewise

#: linear fluxes through a face, of order 3 and 7: weights of the nodes around it
CENTRAL = {
    "seventh-order": np.array([-3, 29, -139, 533, 533, -139, 29, -3]) / 840,
    "seventh-order-positive": np.array([-3, 29, -139, 533, 533, -139, 29, -3]) / 840,
}


class Turning(NamedTuple):
    """What makes a = push - A xi - sum over directions s of (xi_s + flow_s) (shear_s + d omega/dx_s xi).

    A (ny, nx): d_t omega/omega and the drag's rate beta; gradient (d_x, 2, ny, nx): of omega along each direction, for
    velocities that go up and for those that go down there; push (ny, nx, 3): beta u/omega. mean (ny, nx, 3) and T
    (ny, nx) are g's. In the thermal scaling push = -d_t u/omega, flow = u/omega (ny, nx, 3), shears (d_x, 2, ny, nx, 3)
    are the gradients of u, and both gradients are times omega over its mean in the stage; else there is no flow.
    """

    A: Array
    gradient: Array
    push: Array
    mean: Array
    T: Array
    flow: Array | None = None
    shears: Array | None = None

    def speed(self, q: int, at: list[Array]) -> Array:
        """a along q, (ny, nx, px, py, pz), at velocities (px, 1, 1), (1, py, 1), (1, 1, pz)."""
        rate, push = nodewise(self.A), nodewise(self.push[..., q])
        for s, (up, down) in enumerate(self.gradient):
            across = at[s] if self.flow is None else at[s] + nodewise(self.flow[..., s])  # v_s/omega
            rate = rate + np.where(across > 0.0, nodewise(up), nodewise(down)) * across
            if self.shears is not None:
                up, down = self.shears[s][..., q]
                push = push - np.where(across > 0.0, nodewise(up), nodewise(down)) * across
        one = np.ones(np.broadcast_shapes(*(x.shape for x in at)))
        return (push - rate * at[q]) * one

    def most(self, p: Problem) -> Array:
        """The most |A + xi_x . grad omega| in the box."""
        return np.abs(self.A) + sum(np.abs(w).max(axis=0) * p.V[s] for s, w in enumerate(self.gradient))

    def fastest(self, p: Problem, q: int) -> Array:
        """max|a|/h along q, or a bound of it: with flow, of each sum over the directions of space by itself."""
        if self.flow is None or self.shears is None:
            return (self.most(p) * p.V[q] + np.abs(self.push[..., q])) / p.h[q]
        rates = self.extremes(p, self.A, self.gradient)
        pushes = self.extremes(p, -self.push[..., q], self.shears[..., q])
        return (np.abs(rates).max(axis=0) * p.V[q] + np.abs(pushes).max(axis=0)) / p.h[q]

    def extremes(self, p: Problem, own: Array, gradient: Array) -> Array:
        """Bounds of own + sum_s (xi_s + flow_s) gradient_s in the box: met at its edges, or where the sign turns."""
        low, high = own, own
        assert self.flow is not None
        for s, (up, down) in enumerate(gradient):
            first, last = self.flow[..., s] - p.V[s], self.flow[..., s] + p.V[s]
            reached = [x * np.where(x > 0.0, up, down) for x in (first, np.clip(0.0, first, last), last)]
            low, high = low + np.min(reached, axis=0), high + np.max(reached, axis=0)
        return np.stack([low, high])


def drift(p: Problem, g: Array, turning: Turning, loses: Array) -> Array:
    """-div_xi(a g) in finite volumes; nothing passes the edge of the box.

    loses: the rates at which nodes would be empty at the step's end, what they have by then without a drift over dt.
    """
    rate = np.zeros(g.shape)
    for q in range(p.d):
        face, x = list(p.xi), p.xi[q].ravel()
        face[q] = np.reshape(0.5 * (x[:-1] + x[1:]), [-1 if s == q else 1 for s in range(3)])
        a, nodes = (np.moveaxis(turning.speed(q, at), q - 3, -1) for at in (face, p.xi))
        values = np.moveaxis(g, q - 3, -1)
        if p.job.scheme.drift == "maxwellian":
            axis, nodes_at = p.xi[q].ravel(), nodewise(turning.mean[..., q])
            through = relative_flux(a, values, axis, nodes_at, nodewise(width(p, turning)))
            total = sum(turning.fastest(p, s) for s in range(p.d))
            share = 0.999 * p.h[q] * turning.fastest(p, q) / np.where(total > 0.0, total, 1.0)
            through = within(through, np.moveaxis(loses, q - 3, -1) * nodewise(share))
        elif p.job.scheme.drift == "van-leer":
            through = limited_flux(a, values)
        else:
            through = linear_flux(CENTRAL[p.job.scheme.drift], a, nodes * values, values)
        if p.job.scheme.drift == "seventh-order-positive":
            fastest, most = (nodewise(p.h[q] * r) for r in (turning.fastest(p, q), turning.most(p)))
            through = bounded(through, a, values, fastest, most)
        rate -= np.moveaxis(np.diff(beside(through, 1)), -1, q - 3) / p.h[q]
    return rate


def width(p: Problem, turning: Turning) -> Array:
    """The temperature of the Maxwellian that g is reconstructed relative to; none so narrow that it overflows."""
    farthest = sum((p.V[q] + np.abs(turning.mean[..., q])) ** 2 for q in range(p.d))
    return np.maximum(turning.T, farthest / 1200.0)


def sampled(x: Array, h: float, sign: float, mean: Array, T: Array) -> Array:
    """The Gaussian whose samples have this mean and variance, by the first harmonic of Poisson's sum.

    sign: 1 for samples at multiples of h, -1 for samples half between them.
    """
    wave, centre, width = 2.0 * np.pi / h, mean, T
    for _ in range(3):
        share = 2.0 * sign * np.exp(-0.5 * wave**2 * width)
        phase = wave * centre
        centre = mean + width * wave * share * np.sin(phase)
        width = T + np.clip((width * wave) ** 2 * share * np.cos(phase), -0.4 * T, 0.4 * T)
    whole = np.sqrt(width) * np.maximum(1.0 + share * np.cos(wave * centre), 0.5)
    return np.exp(-0.5 * (x - centre) ** 2 / width) / whole


def relative_flux(a: Array, g: Array, axis: Array, mean: Array, T: Array) -> Array:
    """a g on the faces as a M v, v from h = g/M by a bounded parabola; M of this mean and temperature."""
    h, odd = axis[1] - axis[0], 1.0 if len(axis) % 2 == 1 else -1.0
    M = sampled(axis, h, odd, mean, T)
    M_face = sampled(0.5 * (axis[:-1] + axis[1:]), h, -odd, mean, T)
    h = g / M
    across = np.diff(h)
    # a face at an end has the one difference for the missing one
    below = np.concatenate([across[..., :1], across[..., :-1]], axis=-1)
    above = np.concatenate([across[..., 1:], across[..., -1:]], axis=-1)
    upward = h[..., :-1] + towards_face(below, across)
    return a * M_face * np.where(a > 0.0, upward, h[..., 1:] - towards_face(above, across))


def towards_face(upwind: Array, ahead: Array) -> Array:
    """The parabola's step from the upwind node to the face, within 2 of the difference behind and 1 of that ahead."""
    most = np.minimum(2.0 * np.abs(upwind), np.abs(ahead))
    step = np.minimum(np.abs(upwind + 3.0 * ahead) / 8.0, most)
    return np.where(upwind * ahead > 0.0, np.sign(ahead) * step, 0.0)


def within(product: Array, most: Array) -> Array:
    """Fluxes whose difference is of fourth order, within what the nodes on both sides may lose.

    That is `most` together: an eighth through each face, three more for either product that goes that way. A
    neighbour's product counts up to 26 times the larger of the two others, where the flux would turn against it.
    """
    before, after = beside(product, 1)[..., :-2], beside(product, 1)[..., 2:]
    far_before, far_after = (26.0 * np.maximum(np.abs(product), np.abs(other)) for other in (after, before))
    bend = np.clip(before, -far_before, far_before) - 2.0 * product + np.clip(after, -far_after, far_after)
    flux = product - bend / 24.0
    up = 0.125 + 0.375 * (product > 0.0) + 0.375 * (before > 0.0)
    down = 0.125 + 0.375 * (product < 0.0) + 0.375 * (after < 0.0)
    held = np.maximum(most, 0.0)
    return np.clip(flux, -down * held[..., 1:], up * held[..., :-1])


def beside(values: Array, count: int) -> Array:
    """Values with zeros before and after them, along the last axis."""
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(count, count)])


def limited_flux(a: Array, g: Array) -> Array:
    """a times g upwind with Van Leer's slope, none in the outermost nodes."""
    step = np.diff(g)
    bend = beside(half_slope(step[..., :-1], step[..., 1:]), 1)
    return a * np.where(a > 0.0, g[..., :-1] + bend[..., :-1], g[..., 1:] - bend[..., 1:])


def linear_flux(c: Array, a: Array, ag: Array, g: Array) -> Array:
    """sum of c_t (a g)_t over the nodes, - |a| times the difference that takes the node farthest downwind out."""
    ag, g = beside(ag, len(c) // 2 - 1), beside(g, len(c) // 2 - 1)
    central = sum(weight * ag[..., t : t + a.shape[-1]] for t, weight in enumerate(c))
    return central - c[-1] * np.abs(a) * np.diff(g, len(c) - 1)


def bounded(flux: Array, a: Array, g: Array, fastest: Array, spread: Array) -> Array:
    """The flux, cut to what the nodes on both sides may lose: fastest = max|a|, spread = h r of docs/method.md.

    2 max|a| g in each direction: 2 max|a| - h r with a, h r against it, half of it either way where |a| < 2 h r.
    """

    def share(along: Array) -> Array:
        ahead = np.where(along > 2.0 * spread, 2.0 * fastest - spread, fastest)
        return np.where(along > 0.0, ahead, spread)

    held = np.maximum(g, 0.0)
    return np.clip(flux, -share(-a) * held[..., 1:], share(a) * held[..., :-1])
