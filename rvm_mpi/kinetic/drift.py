"""div_xi (a g): the total drift in velocity space, and the update of a cell's block by all explicit terms.

a(xi) = - (A + xi_x . grad omega) xi + beta u, where A = d_t omega / omega + beta holds the scaling's own rate and the
drag's, so that the two cancel as numbers before anything is upwinded. The faces at the edge of the box are closed.

Two reconstructions: Van Leer's limiter (`update`), positive, and linear upwind-biased differences of odd order
(`update_linear`), without a limiter. The latter take the product a g at the nodes, not a times a reconstructed g: a
polynomial's moment with what they give is then exact up to their order (but for the upwinding's kink where a changes
sign), so that heat flux and fourth cumulant of a smooth g are hardly touched by the grid. Those in `POSITIVE` carry
through a face no more than leaves g positive, which a g the grid resolves meets in its tails alone.
"""

from __future__ import annotations

import math
from math import comb
from typing import NamedTuple

import numpy as np

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import (
    fma,
    load,
    maximum,
    minimum,
    prefetch,
    shifted,
    splat,
    spread,
    store,
    upwind,
    where_positive,
)
from rvm_mpi.grid.velocity import LEAST, TAPS, Y_FACE, Y_LEAST, Y_OPEN, Z_FACE, Z_LEAST, Z_OPEN, Z_TAPS, Y, Z
from rvm_mpi.kinetic.limiter import van_leer3

#: order of the linear reconstructions by their name in the job file
ORDERS = {"kappa": 3, "seventh-order": 7, "seventh-order-positive": 7}
#: those whose fluxes are bounded so that g stays positive
POSITIVE = ("seventh-order-positive",)
#: rows of a slab that `scratch` holds
SCRATCH_ROWS = 9
#: nodes of a slab, at most, that are updated for every xi_x before the next: what belongs to them stays in the nearest
#: cache
PIECE = 256


class Drift(NamedTuple):
    """a(xi) = -(own + xi . gradient) xi + push of a cell.

    own is A = d_t omega/omega and the drag's rate together; rising and falling are d omega/dx and d omega/dy as
    velocities that go up and down along that direction see it; push is beta u/omega.
    """

    own: float
    rising_x: float
    falling_x: float
    rising_y: float
    falling_y: float
    push: tuple[float, float, float]


class Mix(NamedTuple):
    """What becomes of the change: weight_old * old + weight_new * (g + dt * change); `old` as g, with its offset."""

    old: np.ndarray
    weight_old: float
    weight_new: float
    dt: float


def scratch_size(points: tuple[int, int, int], slab_size: int) -> int:
    """Doubles of work space: rows of a slab, zeros before and after each, coefficients, fluxes between pieces."""
    rows = SCRATCH_ROWS * (slab_size + 2 * _guard.py_func(points[2]))
    return rows + 3 * TAPS + points[0] * int(_whole_vectors.py_func(points[2]))


def reach(points_z: int, slab_size: int) -> int:
    """How many doubles before and after a block `update` reads; what it finds there must be numbers."""
    return 2 * slab_size + points_z + 16


@part
def _guard(points_z):  # type: ignore[no-untyped-def]
    """Zeros before and after a row of `scratch`: what the widest stencil reaches in y."""
    return (TAPS // 2) * points_z + 8


@part
def _whole_vectors(count):  # type: ignore[no-untyped-def]
    """The count rounded up to whole vectors."""
    return (count + 7) // 8 * 8


@part
def _piece(points_z):  # type: ignore[no-untyped-def]
    """Nodes of a piece: whole vectors and whole rows along z, so that no flux along z crosses into the next."""
    step = points_z
    while step % 8 != 0:
        step += points_z
    return max(PIECE // step, 1) * step


def stencil(order: int) -> np.ndarray:
    """Coefficients (2, TAPS) of the linear flux of odd order through a face, from the nodes around it in order.

    Zero for the nodes that the order does not need: loops over them have one length, known to the compiler.
    The flux is sum_t c_t (a g)_t - |a| sum_t d_t g_t: the central one of order p + 1 (first row), and the
    difference of order p (second row) that takes the node farthest downwind out of it.
    """
    half = (order + 1) // 2
    odd = np.array([[2.0 * k ** (2 * i + 1) for k in range(1, half + 1)] for i in range(half)])
    derivative = np.linalg.solve(odd, np.eye(half)[0])
    upper = np.cumsum(derivative[::-1])[::-1]
    central = np.concatenate([upper[::-1], upper])
    difference = np.array([(-1.0) ** (order - t) * comb(order, t) for t in range(order + 1)])
    return np.pad([central, upper[-1] * difference], ((0, 0), (TAPS // 2 - half,) * 2))


@part
def fastest_turning(drift, half_width):  # type: ignore[no-untyped-def]
    """The largest |A + xi . grad omega| in the box."""
    turning = abs(drift.own) + max(abs(drift.rising_x), abs(drift.falling_x)) * half_width[0]
    return turning + max(abs(drift.rising_y), abs(drift.falling_y)) * half_width[1]


@part
def update(g, cell, grid, drift, mix, scratch, result):  # type: ignore[no-untyped-def]
    """result = the mix of g + dt * (result + drift) with an old block, for one cell.

    Parameters
    ----------
    g : (n,) array
        Blocks; this cell's begins at `cell`, which is also its offset in `mix.old`.
    grid : data.Grid
    drift : Drift
    mix : Mix
    scratch : (scratch_size,) array
        Work space; zeros between its rows.
    result : (block,) array
        The rate of change by transport (`transport.py`); receives the new block.
    """
    points_x, points_y, points_z = grid.points
    slab_size, x, x_face, slab = grid.slab_size, grid.x, grid.x_face, grid.slab
    guard = _guard(points_z)
    row = slab_size + 2 * guard
    slope_x, slope_y, slope_z = guard, row + guard, 2 * row + guard
    through_x, through_y, slope_next = 3 * row + guard, 4 * row + guard, 5 * row + guard
    turns, speeds_y, speeds_z = 6 * row + guard, 7 * row + guard, 8 * row + guard
    a, rising_x, falling_x = drift.own, drift.rising_x, drift.falling_x
    rising_y, falling_y = splat(drift.rising_y), splat(drift.falling_y)
    per_x, per_y, per_z = grid.per_spacing
    push_x, push_y, push_z = drift.push[0] * per_x, drift.push[1] * per_y, drift.push[2] * per_z
    old, weight_old, weight_new, dt = mix.old, mix.weight_old, mix.weight_new, mix.dt
    zero = splat(0.0)
    has_y, has_z = points_y > 1, points_z > 1
    mix_old = weight_old != 0.0
    piece, above = _piece(points_z), _whole_vectors(points_z)
    for begin in range(0, slab_size, piece):
        end = min(begin + piece, slab_size)
        # fluxes along y from this piece to the next, for one xi_x after the other
        between = SCRATCH_ROWS * row + 3 * TAPS
        # the part of the faces' speeds in y and z (over h) that is the same for every xi_x
        for n in range(begin, end, 8):
            y, yf = load(slab, Y * slab_size + n), load(slab, Y_FACE * slab_size + n)
            zf = load(slab, Z_FACE * slab_size + n)
            turn = y * where_positive(y, rising_y, falling_y)
            store(scratch, turns + n, turn)
            turn_yf = yf * yf * where_positive(yf, rising_y, falling_y)
            store(scratch, speeds_y + n, load(slab, Y_OPEN * slab_size + n) * push_y - turn_yf * per_y)
            store(scratch, speeds_z + n, load(slab, Z_OPEN * slab_size + n) * push_z - zf * turn * per_z)
            store(scratch, slope_x + n, zero)
            store(scratch, through_x + n, zero)
        for k in range(points_x):
            base = cell + k * slab_size
            at = k * slab_size
            xk, xf = x[k], x_face[k]
            along = a + (rising_x if xk > 0.0 else falling_x) * xk
            along_y, along_z = -along * per_y, -along * per_z
            inside = 1.0 if k < points_x - 1 else 0.0
            least_x = splat(LEAST if k < points_x - 2 else math.inf)
            sx0 = inside * per_x * (-(a + (rising_x if xf > 0.0 else falling_x) * xf) * xf) + inside * push_x
            sx1 = -inside * per_x * xf
            # slopes: of the next slab along x, of this one along y and z, there for one row of the next piece too
            for n in range(begin, min(end + above, slab_size), 8):
                prefetch(old, cell + at + 2 * slab_size + n)
                c = load(g, base + n)
                next_x = load(g, base + slab_size + n)
                step, ahead = next_x - c, load(g, base + 2 * slab_size + n) - next_x
                down_y, up_y = c - load(g, base + n - points_z), load(g, base + n + points_z) - c
                down_z, up_z = c - load(g, base + n - 1), load(g, base + n + 1) - c
                least_y, least_z = load(slab, Y_LEAST * slab_size + n), load(slab, Z_LEAST * slab_size + n)
                bend_x, bend_y, bend_z = van_leer3(step, ahead, least_x, down_y, up_y, least_y, down_z, up_z, least_z)
                store(scratch, slope_next + n, bend_x)
                store(scratch, slope_y + n, bend_y)
                store(scratch, slope_z + n, bend_z)
            if begin > 0:
                for n in range(0, above, 8):
                    store(scratch, through_y + begin - points_z + n, load(scratch, between + n))
            before_z = zero
            for n in range(begin, end, 8):
                c = load(g, base + n)
                r = load(result, at + n)

                s = fma(load(scratch, turns + n), sx1, splat(sx0))
                left = c + load(scratch, slope_x + n)
                right = load(g, base + slab_size + n) - load(scratch, slope_next + n)
                f = upwind(s, left, right)
                r = r + (load(scratch, through_x + n) - f)
                store(scratch, through_x + n, f)

                if has_y:
                    s = fma(load(slab, Y_FACE * slab_size + n), along_y, load(scratch, speeds_y + n))
                    left = c + load(scratch, slope_y + n)
                    right = load(g, base + n + points_z) - load(scratch, slope_y + n + points_z)
                    f = upwind(s, left, right)
                    store(scratch, through_y + n, f)
                    r = r + (load(scratch, through_y + n - points_z) - f)
                if has_z:
                    s = fma(load(slab, Z_FACE * slab_size + n), along_z, load(scratch, speeds_z + n))
                    left = c + load(scratch, slope_z + n)
                    right = load(g, base + n + 1) - load(scratch, slope_z + n + 1)
                    f = upwind(s, left, right)
                    r = r + (shifted(before_z, f) - f)
                    before_z = f
                r = fma(r, dt, c) * weight_new
                if mix_old:
                    r = fma(load(old, cell + at + n), weight_old, r)
                store(result, at + n, r)
            if end < slab_size:
                for n in range(0, above, 8):
                    store(scratch, between + n, load(scratch, through_y + end - points_z + n))
            between += above
            slope_x, slope_next = slope_next, slope_x


@part
def most_outflow(fastest, turning):  # type: ignore[no-untyped-def]
    """Rates at most at which a node may lose what it has through a face of one direction, for `within_bounds`.

    Up to a Courant number of one half a node may lose 2 max|a|/h in that direction through both its faces: nearly all
    of it with a, and what is left against it; half of it through each where a may change sign between the faces, which
    differ by less than 2 turning.

    Parameters
    ----------
    fastest : float
        max|a|/h of the direction.
    turning : float
        |A| and V times the gradients of omega.
    """
    return splat(2.0 * fastest - turning), splat(fastest), splat(turning), splat(2.0 * turning)


@part
def within_bounds(flux, speed, most, left, right):  # type: ignore[no-untyped-def]
    """The flux, as far as neither node loses more than `most_outflow`."""
    with_it, by_half, against, near = most
    zero = splat(0.0)
    back = zero - speed
    up = where_positive(speed - near, with_it, where_positive(speed, by_half, against))
    down = where_positive(back - near, with_it, where_positive(back, by_half, against))
    return maximum(minimum(flux, up * maximum(left, zero)), zero - down * maximum(right, zero))


@part
def update_linear(g, cell, grid, drift, mix, scratch, result):  # type: ignore[no-untyped-def]
    """`update` with the linear reconstruction of `grid.stencil` in place of Van Leer's limiter."""
    points_x, points_y, points_z = grid.points
    slab_size, x, x_face, slab, coefficients = grid.slab_size, grid.x, grid.x_face, grid.slab, grid.stencil
    bounded = grid.bounded
    below = TAPS // 2 - 1
    guard = _guard(points_z)
    row = slab_size + 2 * guard
    own, in_y, in_z = guard, row + guard, 2 * row + guard
    through_x, through_y = 3 * row + guard, 4 * row + guard
    at_x = SCRATCH_ROWS * row
    a, rising_x, falling_x = drift.own, drift.rising_x, drift.falling_x
    rising_y, falling_y = splat(drift.rising_y), splat(drift.falling_y)
    per_x, per_y, per_z = grid.per_spacing
    push_x, push_y, push_z = drift.push[0] * per_x, drift.push[1] * per_y, drift.push[2] * per_z
    old, weight_old, weight_new, dt = mix.old, mix.weight_old, mix.weight_new, mix.dt
    half_width = grid.half_width
    most = fastest_turning(drift, half_width)
    most_x = most_outflow(most * half_width[0] * per_x + abs(push_x), most)
    most_y = most_outflow(most * half_width[1] * per_y + abs(push_y), most)
    most_z = most_outflow(most * half_width[2] * per_z + abs(push_z), most)
    zero = splat(0.0)
    for n in range(0, slab_size, 8):
        store(scratch, through_x + n, zero)
        store(scratch, through_y + n, zero)
    has_y, has_z = points_y > 1, points_z > 1
    mix_old = weight_old != 0.0
    for k in range(points_x):
        base = cell + k * slab_size
        at = k * slab_size
        xk, xf = x[k], x_face[k]
        along = a + (rising_x if xk > 0.0 else falling_x) * xk
        inside = per_x if k < points_x - 1 else 0.0
        sx0 = inside * -(a + (rising_x if xf > 0.0 else falling_x) * xf) * xf + (push_x if inside > 0.0 else 0.0)
        sx1 = -inside * xf
        for t in range(TAPS):
            there = k + t - below
            taken = 1.0 if inside > 0.0 and 0 <= there < points_x else 0.0
            xt = x[min(max(there, 0), points_x - 1)]
            turning = a + (rising_x if xt > 0.0 else falling_x) * xt
            scratch[at_x + t] = taken * coefficients[0, t] * (push_x - turning * xt * per_x)
            scratch[at_x + TAPS + t] = taken * coefficients[0, t] * xt * per_x
            scratch[at_x + 2 * TAPS + t] = taken * coefficients[1, t]
        for n in range(0, slab_size, 8):
            c = load(g, base + n)
            y, z = load(slab, Y * slab_size + n), load(slab, Z * slab_size + n)
            s = splat(-along) - y * where_positive(y, rising_y, falling_y)
            store(scratch, own + n, c)
            if has_y:
                store(scratch, in_y + n, (y * s * per_y + splat(push_y)) * c)
            if has_z:
                store(scratch, in_z + n, (z * s * per_z + splat(push_z)) * c)
        before_z = zero
        for n in range(0, slab_size, 8):
            y = load(slab, Y * slab_size + n)
            turn_y = y * where_positive(y, rising_y, falling_y)
            r = load(result, at + n)

            flux, turned, bend = zero, zero, zero
            for t in range(TAPS):
                there = load(g, cell + min(max(k + t - below, 0), points_x - 1) * slab_size + n)
                flux = fma(there, spread(scratch, at_x + t), flux)
                turned = fma(there, spread(scratch, at_x + TAPS + t), turned)
                bend = fma(there, spread(scratch, at_x + 2 * TAPS + t), bend)
            speed = turn_y * sx1 + splat(sx0)
            f = flux - turn_y * turned - maximum(speed, zero - speed) * bend
            if bounded:
                f = within_bounds(f, speed, most_x, load(scratch, own + n), load(g, base + slab_size + n))
            r = r + (load(scratch, through_x + n) - f)
            store(scratch, through_x + n, f)

            if has_y:
                yf = load(slab, Y_FACE * slab_size + n)
                speed = yf * (splat(-along) - yf * where_positive(yf, rising_y, falling_y)) * per_y + splat(push_y)
                flux, bend = zero, zero
                for t in range(TAPS):
                    there = n + (t - below) * points_z
                    flux = fma(load(scratch, in_y + there), coefficients[0, t], flux)
                    bend = fma(load(scratch, own + there), coefficients[1, t], bend)
                f = flux - maximum(speed, zero - speed) * bend
                if bounded:
                    f = within_bounds(f, speed, most_y, load(scratch, own + n), load(scratch, own + n + points_z))
                f = f * load(slab, Y_OPEN * slab_size + n)
                store(scratch, through_y + n, f)
                r = r + (load(scratch, through_y + n - points_z) - f)
            if has_z:
                zf = load(slab, Z_FACE * slab_size + n)
                speed = zf * (splat(-along) - turn_y) * per_z + splat(push_z)
                flux, bend = zero, zero
                for t in range(TAPS):
                    valid = load(slab, (Z_TAPS + t) * slab_size + n)
                    flux = fma(load(scratch, in_z + n + t - below), valid * coefficients[0, t], flux)
                    bend = fma(load(scratch, own + n + t - below), valid * coefficients[1, t], bend)
                f = flux - maximum(speed, zero - speed) * bend
                if bounded:
                    f = within_bounds(f, speed, most_z, load(scratch, own + n), load(scratch, own + n + 1))
                f = f * load(slab, Z_OPEN * slab_size + n)
                r = r + (shifted(before_z, f) - f)
                before_z = f
            r = fma(r, dt, load(scratch, own + n)) * weight_new
            if mix_old:
                r = fma(load(old, cell + at + n), weight_old, r)
            store(result, at + n, r)


@part
def apply(g, cell, grid, drift, mix, scratch, result):  # type: ignore[no-untyped-def]
    """`update`, or `update_linear` where the grid has a stencil."""
    if grid.linear:
        update_linear(g, cell, grid, drift, mix, scratch, result)
    else:
        update(g, cell, grid, drift, mix, scratch, result)
