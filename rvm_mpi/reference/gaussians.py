"""Functions exp(quadratic) on the velocity grid with moments given exactly: the discrete Gaussian, the correction."""

from __future__ import annotations

from math import sqrt

import numpy as np

from rvm_mpi.reference.state import Array, Problem

#: what a Gaussian's variance must have above the least that nodes can hold, in h^2
ROOM = 0.01


def fitted(weight: Array, basis: Array, wanted: Array, start: Array) -> Array:
    """theta for which weight exp(theta . basis) has the sums `wanted` of the basis: Newton's method, to round-off.

    weight (n,), basis (k, n), wanted (k,), start (k,). A step is one at most, and
    halved until it leaves a smaller mismatch.
    """
    theta, step, off = start, np.zeros(len(start)), np.inf
    for _ in range(300):
        with np.errstate(over="ignore", invalid="ignore"):
            values = weight * np.exp((theta + step) @ basis)
            lack = wanted - basis @ values
        size = np.abs(lack).max() / wanted[0]  # the first of the basis is one
        if size < off:
            theta, off = theta + step, size
            step = np.linalg.solve((basis * values) @ basis.T, lack)
            step = step / max(1.0, np.abs(step).sum())
        elif off < 1e-13:
            return theta
        else:
            step = 0.5 * step
    raise ArithmeticError(f"Newton's method leaves a mismatch of {off:.3g}")


def least_variance(x: Array, mean: float) -> float:
    """The least variance that a positive function on these nodes can have with this mean."""
    j = min(max(int((mean - x[0]) / (x[1] - x[0])), 0), len(x) - 2)
    return float((mean - x[j]) * (x[j + 1] - mean))


def axis_gaussian(x: Array, mean: float, variance: float) -> Array:
    """exp(quadratic) on the nodes of one axis with sum one, this mean and this variance."""
    return gaussian([x], 1.0, np.array([mean]), np.array([[variance]]))


def gaussian(axes: list[Array], density: float, mean: Array, tensor: Array) -> Array:
    """exp(quadratic) on a grid of nodes with the sum, mean (k,) and covariance (k, k) given: positive, exact."""
    k, thermal = len(axes), np.sqrt(np.diag(tensor))
    c = np.meshgrid(*((x - u) / t for x, u, t in zip(axes, mean, thermal)), indexing="ij")
    pairs = [(a, b) for a in range(k) for b in range(a, k)]
    basis = np.array([np.ones(c[0].shape), *c, *(c[a] * c[b] for a, b in pairs)]).reshape(1 + k + len(pairs), -1)
    scaled = tensor / np.outer(thermal, thermal)
    wanted = np.array([1.0, *np.zeros(k), *(scaled[a, b] for a, b in pairs)])
    inverse = np.linalg.inv(scaled)
    start = np.array([0.0, *np.zeros(k), *(-(0.5 if a == b else 1.0) * inverse[a, b] for a, b in pairs)])
    start[0] = -np.log(np.exp(start @ basis).sum())
    return density * np.exp(fitted(np.ones(basis.shape[1]), basis, wanted, start) @ basis).reshape(c[0].shape)


def discrete_gaussian(p: Problem, density: float, mean: Array, tensor: Array) -> Array:
    """G (px, py, pz) with these sum, mean (d,) and temperature tensor (d, d), or the nearest tensor of the same trace.

    An axis whose variance no positive function on the nodes has takes the least that one has, and no correlation; the
    others give the difference in proportion to their room.
    """
    axes = [p.xi[q].ravel() for q in range(p.d)]
    floor = np.array([least_variance(x, u) for x, u in zip(axes, mean)]) + ROOM * p.h[: p.d] ** 2
    room = np.diag(tensor) - floor
    short, slack = -room[room < 0.0].sum(), room[room >= 0.0].sum()
    if short > 0.0:
        if slack <= short:
            raise ArithmeticError("the velocity grid cannot hold the temperature")
        keep, free = 1.0 - short / slack, room >= 0.0
        tensor = tensor * keep * np.outer(free, free)
        tensor[np.diag_indices(p.d)] = floor + np.where(free, keep * room, 0.0)
    return gaussian(axes, density, mean, tensor).reshape(p.five[0].shape)


def about(p: Problem, target: Array) -> tuple[Array, Array]:
    """1, c, |c|^2 of c = (xi - u)/sqrt(T), and what their sums are where those of 1, xi, |xi|^2/2 are the target's."""
    density, u = target[0], target[1 : 1 + p.d] / target[0]
    spread = 2.0 * target[4] / density - np.sum(u**2)
    c = [(p.xi[q] - u[q]) / sqrt(spread / p.d) * np.ones(p.five[0].shape) for q in range(p.d)]
    basis = np.array([np.ones(c[0].shape), *c, sum(x**2 for x in c)]).reshape(2 + p.d, -1)
    return basis, density * np.array([1.0, *np.zeros(p.d), p.d])


def corrected(p: Problem, g: Array, target: Array) -> Array:
    """g exp(c0 + c . (xi - u) + c2 |xi - u|^2) with the sums of 1, xi, |xi|^2/2 given."""
    basis, wanted = about(p, target)
    theta = fitted(g.ravel(), basis, wanted, np.zeros(2 + p.d))
    return g * np.exp(theta @ basis).reshape(g.shape)


def corrected_signed(p: Problem, g: Array, maxwellian: Array, target: Array) -> Array:
    """g + M (c0 + c . (xi - u) + c2 |xi - u|^2), linear, where the spectral operator leaves g below zero in places."""
    basis, wanted = about(p, target)
    matrix = (basis * maxwellian.ravel()) @ basis.T
    return g + maxwellian * (np.linalg.solve(matrix, wanted - basis @ g.ravel()) @ basis).reshape(g.shape)
