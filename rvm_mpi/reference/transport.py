"""div_x(omega xi g): fluxes through the faces of the cells, the moments they carry, and grad omega."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rvm_mpi.reference.sides import with_ghosts
from rvm_mpi.reference.state import Array, Problem, State, face_value, nodewise, sums


class Transport(NamedTuple):
    """What crosses the faces makes of the cells.

    rate: -div_x(omega xi g); moments (ny, nx, 5): N(U), those of it; gradient (d_x, 2, ny, nx): of omega along each
    direction, as xi > 0 and xi < 0 there see it; courant (ny, nx): sum of max|omega xi|/h over the directions.
    """

    rate: Array
    moments: Array
    gradient: Array
    courant: Array


def transport(p: Problem, state: State) -> Transport:
    """Upwind fluxes of g with omega on the face, upwind too where moments are carried."""
    cells, space = state.omega.shape, p.job.space
    rate, N, courant = np.zeros(state.g.shape), np.zeros((*cells, 5)), np.zeros(cells)
    gradient = np.zeros((space.dimensions, 2, *cells))
    for axis, dx in enumerate(space.spacing):
        g, omega, beyond = with_ghosts(p, state, axis)
        up, down = face_values(omega, 0.0)  # a jump of omega must not set gas at rest in motion
        if not p.job.scheme.conservative:
            up = down = 0.5 * (omega[1:-2] + omega[2:-1])
        xi, (lower, upper) = p.xi[axis], face_values(g)
        w = np.where(xi > 0.0, nodewise(up), nodewise(down))
        flux = w * xi * np.where(xi > 0.0, lower, upper) / dx
        # mass, momentum and energy that cross: omega xi_n g times 1, omega xi, omega^2 |xi|^2/2
        mass, momentum, energy = (p.weight * sums(p, w**k * flux) for k in range(3))
        crossing = np.concatenate([mass[..., :1], momentum[..., 1:4], energy[..., 4:]], axis=-1)
        crossing[0] += beyond[0] / dx
        crossing[-1] += beyond[1] / dx
        rate -= np.moveaxis(np.diff(flux, axis=0), 0, 1 - axis)
        N -= np.moveaxis(np.diff(crossing, axis=0), 0, 1 - axis)
        gradient[axis] = [np.moveaxis(np.diff(side, axis=0), 0, 1 - axis) / dx for side in (up, down)]
        fastest = np.max([up[:-1], up[1:], down[:-1], down[1:]], axis=0)
        courant += np.moveaxis(fastest, 0, 1 - axis) * p.V[axis] / dx
    return Transport(rate, N, gradient, courant)


def face_values(cells: Array, room: float = 0.02) -> tuple[Array, Array]:
    """The value on each face as the lower and as the upper cell see it, from cells with two ghosts, axis first."""
    step = np.diff(cells, axis=0)
    below, across, above = step[:-2], step[1:-1], step[2:]
    return face_value(cells[1:-2], below, across, room), face_value(cells[2:-1], -above, -across, room)
