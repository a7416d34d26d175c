"""div_x (omega xi g): upwind fluxes of third order through the faces between cells.

A face flux is kept as the block omega_face xi_n g_face / h, a rate; its moments (1, omega xi, omega^2 |xi|^2) come with
it, for they carry mass, momentum and energy across the face (`conservation.py`). Both g and omega are reconstructed
upwind by `limiter.face_value`, which keeps g >= 0 for a Courant number up to one half in all directions together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import fma, load, prefetch, splat, store, total, where_positive
from rvm_mpi.grid.velocity import Y, Z
from rvm_mpi.kinetic.limiter import face_value

#: nodes of a slab whose face values are kept at a time, few enough for the nearest cache
PIECE = 128
#: doubles ahead of their use that nodes of other cells are asked for: so few that they are still in the nearest cache
#: then; blocks follow one another, so this goes on into the next cell's
AHEAD = 128


class Strips(NamedTuple):
    """Fluxes through faces that the next cells need: west (block,); south, blocks of a row of cells.

    spare (block,) takes the place of one where a ghost cell has no such face; faces (2 PIECE,) is work space.
    """

    west: np.ndarray
    south: np.ndarray
    spare: np.ndarray
    faces: np.ndarray


class UpperFaces(NamedTuple):
    """A cell's upper faces.

    Attributes
    ----------
    along_x, along_y : int
        From a cell's block to that of the cell beyond its upper face.
    per_dx, per_dy : float
        1 over the cell's widths; 0 in an unused direction.
    omegas : tuple of four floats
        omega at the upper x face as the lower and as the upper cell see it, for velocities that go up and down; then
        the same of the upper y face.
    """

    along_x: int
    along_y: int
    per_dx: float
    per_dy: float
    omegas: tuple[float, float, float, float]


@part
def upper_fluxes(g, cell, grid, upper, lower, change, moments_x, moments_y):  # type: ignore[no-untyped-def]
    """The fluxes through a cell's upper faces, and the rate of change they and the lower ones make.

    Parameters
    ----------
    g : (n,) array
        Blocks of cells; this one's begins at `cell`.
    grid : data.Grid
    upper : UpperFaces
    lower : tuple
        West and south: fluxes through the lower faces, overwritten with those through the upper ones, the next cells'
        lower faces; the offset in south; work space (2 PIECE,).
    change : (block,) array
        Receives what enters minus what leaves.
    moments_x, moments_y : (5,) arrays
        Receive the sums of the upper fluxes times 1, omega xi_x, omega xi_y, omega xi_z, omega^2 |xi|^2: mass, momentum
        and twice the energy that cross the face.

    Notes
    -----
    A sweep begins with this function on the ghost cells below its first row and column, so that a face has the same
    flux to the last bit whichever rank works it out.
    """
    along_x, along_y, per_dx, per_dy, omegas = upper
    west, south, south_at, faces = lower
    points_x, slab_size, below, x, slab = grid.points[0], grid.slab_size, grid.below, grid.x, grid.slab
    zero = splat(0.0)
    m0, mx, my, mz, m2 = zero, zero, zero, zero, zero
    p0, px, py, pz, p2 = zero, zero, zero, zero, zero
    for k in range(points_x):
        xk = x[k]
        omega = omegas[0] if xk > 0.0 else omegas[1]
        rate = omega * xk * per_dx
        base = cell + k * slab_size
        at = k * slab_size
        if xk > 0.0:
            here_x, behind_x, ahead_x, new_x = base, base - along_x, base + along_x, base + along_x
        else:
            here_x, behind_x, ahead_x, new_x = base + along_x, base + 2 * along_x, base, base + 2 * along_x
        s0, sy, sz, s2 = zero, zero, zero, zero
        q0, q1, qy, qz, q2, q3 = zero, zero, zero, zero, zero, zero
        for begin in range(0, slab_size, PIECE):
            end = min(begin + PIECE, slab_size)
            # the values on the faces first: a limiter is long in coming, and so more of them are under way at a time
            for n in range(begin, end, 8):
                # a processor finds out by itself what comes next, but anew for each page
                prefetch(g, new_x + AHEAD + n)
                prefetch(g, base + along_y + AHEAD + n)
                prefetch(g, (base - along_y if n >= below else base + 2 * along_y) + AHEAD + n)
                u = load(g, here_x + n)
                if n >= below:
                    v, behind, ahead = load(g, base + n), load(g, base - along_y + n), load(g, base + along_y + n)
                elif n + 8 <= below:
                    v, behind, ahead = (
                        load(g, base + along_y + n),
                        load(g, base + 2 * along_y + n),
                        load(g, base + n),
                    )
                else:
                    y = load(slab, Y * slab_size + n)
                    down, up = load(g, base + n), load(g, base + along_y + n)
                    v, ahead = where_positive(y, down, up), where_positive(y, up, down)
                    behind = where_positive(y, load(g, base - along_y + n), load(g, base + 2 * along_y + n))
                store(faces, n - begin, face_value(u, u - load(g, behind_x + n), load(g, ahead_x + n) - u))
                store(faces, PIECE + n - begin, face_value(v, v - behind, ahead - v))
            for n in range(begin, end, 8):
                y = load(slab, Y * slab_size + n)
                z = load(slab, Z * slab_size + n)
                f = load(faces, n - begin) * rate
                omega_y = where_positive(y, splat(omegas[2]), splat(omegas[3]))
                h = load(faces, PIECE + n - begin) * (y * omega_y * per_dy)
                difference = (load(west, at + n) - f) + (load(south, south_at + at + n) - h)
                store(west, at + n, f)
                store(south, south_at + at + n, h)
                store(change, at + n, difference)
                square = fma(y, y, z * z)
                s0 = s0 + f
                sy = fma(f, y, sy)
                sz = fma(f, z, sz)
                s2 = fma(f, square, s2)
                momentum = h * omega_y
                energy = momentum * omega_y
                q0 = q0 + h
                q1 = q1 + momentum
                qy = fma(momentum, y, qy)
                qz = fma(momentum, z, qz)
                q2 = fma(energy, square, q2)
                q3 = q3 + energy
        m0, mx, my, mz = m0 + s0, mx + s0 * (omega * xk), my + sy * omega, mz + sz * omega
        m2 = m2 + (s2 + s0 * (xk * xk)) * (omega * omega)
        p0, px, py, pz, p2 = p0 + q0, px + q1 * xk, py + qy, pz + qz, p2 + (q2 + q3 * (xk * xk))
    moments_x[0], moments_x[1], moments_x[2], moments_x[3], moments_x[4] = (
        total(m0),
        total(mx),
        total(my),
        total(mz),
        total(m2),
    )
    moments_y[0], moments_y[1], moments_y[2], moments_y[3], moments_y[4] = (
        total(p0),
        total(px),
        total(py),
        total(pz),
        total(p2),
    )
