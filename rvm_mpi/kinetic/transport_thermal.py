"""div_x (v g) where each cell has a frame of its own, v = u + omega xi: each side of a face sends its own velocities.

Through a face goes max(v-, 0) g- of the gas below and min(v+, 0) g+ of the gas above, v- and v+ the velocity of a node
in the frame of either on the face: nodes may cross from both sides or from neither. g is reconstructed as in
`transport.py`, node by node. The moments of what crosses are those of velocities v, so the balances are exact.
"""

from __future__ import annotations

from typing import NamedTuple

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import fma, load, maximum, minimum, prefetch, splat, store, total
from rvm_mpi.grid.velocity import Y, Z
from rvm_mpi.kinetic.limiter import face_value
from rvm_mpi.kinetic.transport import AHEAD

Frame = tuple[float, float, float, float]


class MovingFaces(NamedTuple):
    """A cell's upper faces.

    Attributes
    ----------
    along_x, along_y : int
        From a cell's block to that of the cell beyond its upper face.
    per_dx, per_dy : float
        1 over the cell's widths; 0 in an unused direction.
    frames : tuple of four frames (u, omega)
        On the upper x face of the gas below and of the gas above it; the same of the upper y face.
    enters : tuple of four bool
        Whether the gas below or above is what a side sends in: the far ghost cell then holds it as it is on the face.
    """

    along_x: int
    along_y: int
    per_dx: float
    per_dy: float
    frames: tuple[Frame, Frame, Frame, Frame]
    enters: tuple[bool, bool, bool, bool]


@part
def value_below(g, at, along, enters):  # type: ignore[no-untyped-def]
    """g of the gas below on the upper face of the cell at `at`."""
    if enters:
        return load(g, at - along)
    u = load(g, at)
    return face_value(u, u - load(g, at - along), load(g, at + along) - u)


@part
def value_above(g, at, along, enters):  # type: ignore[no-untyped-def]
    """g of the gas above on the upper face of the cell at `at`."""
    if enters:
        return load(g, at + 2 * along)
    u = load(g, at + along)
    return face_value(u, u - load(g, at + 2 * along), load(g, at) - u)


@part
def as_moments(frame, sums, moments):  # type: ignore[no-untyped-def]
    """Add to the moments (1, v, |v|^2) those of what crosses in a frame, from its sums of 1, xi, |xi|^2."""
    u0, u1, u2, omega = frame
    m, x, y, z, square = sums
    moments[0] += m
    moments[1] += u0 * m + omega * x
    moments[2] += u1 * m + omega * y
    moments[3] += u2 * m + omega * z
    flow = u0 * x + u1 * y + u2 * z
    moments[4] += (u0 * u0 + u1 * u1 + u2 * u2) * m + omega * (2.0 * flow + omega * square)


@part
def moving_fluxes(g, cell, grid, upper, lower, change, moments_x, moments_y):  # type: ignore[no-untyped-def]
    """`transport.upper_fluxes` with frames.

    Parameters
    ----------
    g : (n,) array
        Blocks of cells; this one's begins at `cell`.
    grid : data.Grid
    upper : MovingFaces
    lower : tuple
        West and south: fluxes through the lower faces, overwritten with those through the upper ones; the offset in
        south.
    change : (block,) array
        Receives what enters minus what leaves.
    moments_x, moments_y : (5,) arrays
        Receive the sums of the upper fluxes times 1, v, |v|^2.
    """
    along_x, along_y, per_dx, per_dy, frames, enters = upper
    below_x, above_x, below_y, above_y = frames
    west, south, south_at = lower
    points_x, slab_size, x, slab = grid.points[0], grid.slab_size, grid.x, grid.slab
    zero = splat(0.0)
    m0, mx, my, mz, m2 = zero, zero, zero, zero, zero
    n0, nx, ny, nz, n2 = zero, zero, zero, zero, zero
    p0, px, py, pz, p2 = zero, zero, zero, zero, zero
    r0, rx, ry, rz, r2 = zero, zero, zero, zero, zero
    # y rises along a slab: the first vector that goes up from below, the one after the last that comes down from above
    first_up, last_down = slab_size, 0
    if per_dy > 0.0:
        for j in range(grid.points[1]):
            y = grid.nodes[1, j]
            if below_y[1] + below_y[3] * y > 0.0 and first_up == slab_size:
                first_up = j * grid.points[2] // 8 * 8
            if above_y[1] + above_y[3] * y < 0.0:
                last_down = min(slab_size, (j + 1) * grid.points[2])
    for k in range(points_x):
        xk = x[k]
        base, at = cell + k * slab_size, k * slab_size
        up, down = (below_x[0] + below_x[3] * xk) * per_dx, (above_x[0] + above_x[3] * xk) * per_dx
        if up > 0.0:
            s0, sy, sz, s2 = zero, zero, zero, zero
            for n in range(0, slab_size, 8):
                prefetch(g, base + along_x + AHEAD + n)
                y, z = load(slab, Y * slab_size + n), load(slab, Z * slab_size + n)
                f = value_below(g, base + n, along_x, enters[0]) * up
                store(change, at + n, load(west, at + n) - f)
                store(west, at + n, f)
                s0, sy, sz, s2 = s0 + f, fma(f, y, sy), fma(f, z, sz), fma(f, fma(y, y, z * z), s2)
            m0, mx, my, mz, m2 = m0 + s0, mx + s0 * xk, my + sy, mz + sz, m2 + (s2 + s0 * (xk * xk))
        if down < 0.0:
            s0, sy, sz, s2 = zero, zero, zero, zero
            both = up > 0.0
            for n in range(0, slab_size, 8):
                prefetch(g, base + 2 * along_x + AHEAD + n)
                y, z = load(slab, Y * slab_size + n), load(slab, Z * slab_size + n)
                f = value_above(g, base + n, along_x, enters[1]) * down
                before = load(west, at + n)
                store(change, at + n, (load(change, at + n) if both else before) - f)
                store(west, at + n, before + f if both else f)
                s0, sy, sz, s2 = s0 + f, fma(f, y, sy), fma(f, z, sz), fma(f, fma(y, y, z * z), s2)
            n0, nx, ny, nz, n2 = n0 + s0, nx + s0 * xk, ny + sy, nz + sz, n2 + (s2 + s0 * (xk * xk))
        if not (up > 0.0 or down < 0.0):
            for n in range(0, slab_size, 8):
                store(change, at + n, load(west, at + n))
                store(west, at + n, zero)
        if per_dy > 0.0:
            s0, sy, sz, s2 = zero, zero, zero, zero
            t0, ty, tz, t2 = zero, zero, zero, zero
            for n in range(0, slab_size, 8):
                prefetch(g, base + 2 * along_y + AHEAD + n)
                y, z = load(slab, Y * slab_size + n), load(slab, Z * slab_size + n)
                square, h = fma(y, y, z * z), zero
                if n >= first_up:
                    speed = maximum(fma(y, splat(below_y[3]), splat(below_y[1])), zero) * per_dy
                    f = value_below(g, base + n, along_y, enters[2]) * speed
                    h = h + f
                    s0, sy, sz, s2 = s0 + f, fma(f, y, sy), fma(f, z, sz), fma(f, square, s2)
                if n < last_down:
                    speed = minimum(fma(y, splat(above_y[3]), splat(above_y[1])), zero) * per_dy
                    f = value_above(g, base + n, along_y, enters[3]) * speed
                    h = h + f
                    t0, ty, tz, t2 = t0 + f, fma(f, y, ty), fma(f, z, tz), fma(f, square, t2)
                store(change, at + n, load(change, at + n) + (load(south, south_at + at + n) - h))
                store(south, south_at + at + n, h)
            p0, px, py, pz, p2 = p0 + s0, px + s0 * xk, py + sy, pz + sz, p2 + (s2 + s0 * (xk * xk))
            r0, rx, ry, rz, r2 = r0 + t0, rx + t0 * xk, ry + ty, rz + tz, r2 + (t2 + t0 * (xk * xk))
    for q in range(5):
        moments_x[q] = 0.0
        moments_y[q] = 0.0
    as_moments(below_x, (total(m0), total(mx), total(my), total(mz), total(m2)), moments_x)
    as_moments(above_x, (total(n0), total(nx), total(ny), total(nz), total(n2)), moments_x)
    as_moments(below_y, (total(p0), total(px), total(py), total(pz), total(p2)), moments_y)
    as_moments(above_y, (total(r0), total(rx), total(ry), total(rz), total(r2)), moments_y)
