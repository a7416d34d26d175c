"""What a step knows and changes, and the moments of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rvm_mpi.job.job import Job

Array = np.ndarray


@dataclass(frozen=True)
class State:
    """g (ny, nx, px, py, pz), omega (ny, nx), and carried U = (rho, rho u, E) of f (ny, nx, 5), not always in use.

    In the thermal scaling v = u + omega xi with the carried u.
    """

    g: Array
    omega: Array
    U: Array


@dataclass(frozen=True)
class Problem:
    """A job, its velocities, and what its sides send in.

    Attributes
    ----------
    xi : list of three arrays, (px, 1, 1), (1, py, 1), (1, 1, pz)
    five : (5, px, py, pz) array
        1, xi, |xi|^2/2.
    h, V : (3,) arrays
        Spacing and half width.
    weight : float
        Volume of a velocity cell.
    sides : dict of (axis, end) -> (n, 5) array
        rho, u, T of the wall or far gas along a side of physical space, axis 0 x, end 0 the lower.
    """

    job: Job
    d: int
    xi: list[Array]
    five: Array
    h: Array
    V: Array
    weight: float
    sides: dict[tuple[int, int], Array]

    @classmethod
    def of(cls, job: Job, density: Array, velocity: Array, temperature: Array) -> Problem:
        """From a job and its initial state, (ny, nx), (ny, nx, d), (ny, nx): a side's state where the job says none."""
        d = job.velocity.dimensions
        points, V = np.array([*job.velocity.points, 1, 1][:3]), np.array([*job.velocity.half_width, 0.0, 0.0][:3])
        xi = np.meshgrid(*((2 * np.arange(n) + 1 - n) * v / n for n, v in zip(points, V)), indexing="ij", sparse=True)
        one = np.ones(tuple(points))
        five = np.array([one, *(one * x for x in xi), one * 0.5 * sum(x**2 for x in xi)])
        h = np.where(V > 0.0, 2.0 * V / points, 1.0)
        state = np.zeros((*density.shape, 5))
        state[..., 0], state[..., 1 : 1 + d], state[..., 4] = density, velocity, temperature
        sides = {}
        for axis, end in np.ndindex(len(job.space.cells), 2):
            side = job.space.sides["xy"[axis] + ("-lower", "-upper")[end]]
            there = np.moveaxis(state, 1 - axis, 0)[-end].copy()
            for place, value in ((0, side.density), (slice(1, 1 + d), side.velocity), (4, side.temperature)):
                if value is not None:
                    there[:, place] = value
            sides[int(axis), int(end)] = there
        return cls(job, d, list(xi), five, h, V, float(np.prod(h)), sides)

    @property
    def kinetic(self) -> bool:
        """Whether omega = sqrt(2 E/(d rho)) of the carried moments."""
        return self.job.scaling.kind == "kinetic"

    @property
    def thermal(self) -> bool:
        """Whether v = u + omega xi, u and omega = sqrt(T) those of the carried moments."""
        return self.job.scaling.kind == "thermal"

    @property
    def carries(self) -> bool:
        """Whether U is carried; else it is measured from g."""
        return self.kinetic or bool(self.job.scheme.conservative)


def sums(p: Problem, g: Array) -> Array:
    """Sums of 1, xi, |xi|^2/2 times g over the nodes, (..., 5)."""
    return np.einsum("...ijk,qijk->...q", g, p.five)


def second_moments(p: Problem, g: Array) -> Array:
    """Sums of xi xi^T g of a cell, (d, d)."""
    return np.array([[np.sum(p.xi[a] * p.xi[b] * g) for b in range(p.d)] for a in range(p.d)])


def powers(omega: Array) -> Array:
    """1, omega, omega, omega, omega^2: what sums of g are multiplied by to be those of f."""
    return np.stack([omega**0, omega, omega, omega, omega**2], axis=-1)


def shifted(five: Array, u: Array) -> Array:
    """Moments of 1, v, |v|^2/2 where v = u + w, from those of 1, w, |w|^2/2: (..., 5), u (..., 3)."""
    mass, momentum, energy = five[..., :1], five[..., 1:4], five[..., 4:]
    mixed = np.sum(u * momentum, axis=-1, keepdims=True)
    square = np.sum(u * u, axis=-1, keepdims=True)
    return np.concatenate([mass, momentum + mass * u, energy + mixed + 0.5 * mass * square], axis=-1)


def moments(p: Problem, state: State) -> Array:
    """U = (rho, rho u, E) of f from g: rho_f = rho_g, u_f = omega u_g, T_f = omega^2 T_g, and u more if thermal."""
    U = p.weight * sums(p, state.g) * powers(state.omega)
    return shifted(U, mean_velocity(state.U)) if p.thermal else U


def mean_velocity(U: Array) -> Array:
    """u of rho, rho u, E: (..., 3)."""
    return U[..., 1:4] / U[..., :1]


def temperature(p: Problem, U: Array) -> Array:
    """T of E = d rho T/2 + rho |u|^2/2."""
    return (2.0 * U[..., 4] - np.sum(U[..., 1:4] ** 2, axis=-1) / U[..., 0]) / (p.d * U[..., 0])


def nodewise(cells: Array) -> Array:
    """An array of cells to be multiplied with one of g."""
    return cells[..., None, None, None]


def half_slope(a: Array, b: Array) -> Array:
    """Half of Van Leer's slope, a b/(a + b) where differences have one sign."""
    with np.errstate(all="ignore"):
        return np.where(a * b > 0.0, a * b / (a + b), 0.0)


def face_value(u: Array, a: Array, b: Array, room: float = 0.02) -> Array:
    """The value on the face ahead of u, a and b the differences behind and ahead: (2 b + a)/6 beyond u, within bounds.

    Koren's: the smaller difference, none where they differ in sign; but at least that room, in units of u.
    """
    free = room * np.abs(u)
    low, high = np.minimum(-free, np.maximum(a, b)), np.maximum(free, np.minimum(a, b))
    return u + np.clip((2.0 * b + a) / 6.0, low, high)
