"""The drift's fluxes by linear upwind-biased differences of seventh order, without a limiter.

They take the product a g at the nodes, not a times a reconstructed g: a polynomial's moment with what they give is then
exact up to their order (but for the upwinding's kink where a changes sign), so that heat flux and fourth cumulant of a
smooth g are hardly touched by the grid. Those in `POSITIVE` carry through a face no more than leaves g positive, which
a g the grid resolves meets in its tails alone.
"""

from __future__ import annotations

from math import comb

import numpy as np

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import fma, load, maximum, minimum, shifted, splat, spread, store, where_positive
from rvm_mpi.grid.velocity import TAPS, Y_FACE, Y_OPEN, Z_FACE, Z_OPEN, Z_TAPS, Y, Z
from rvm_mpi.kinetic.drift_speed import fastest_turning, guard_of

#: rows of a slab that the work space holds
ROWS = 5
#: order of the linear reconstructions by their name in the job file
ORDERS = {"seventh-order": 7, "seventh-order-positive": 7}
#: those whose fluxes are bounded so that g stays positive
POSITIVE = ("seventh-order-positive",)


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
    """`drift.apply` with the linear reconstruction of `grid.stencil`."""
    points_x, points_y, points_z = grid.points
    slab_size, x, x_face, slab, coefficients = grid.slab_size, grid.x, grid.x_face, grid.slab, grid.stencil
    bounded = grid.bounded
    below = TAPS // 2 - 1
    guard = guard_of(points_z)
    row = slab_size + 2 * guard
    own, in_y, in_z = guard, row + guard, 2 * row + guard
    through_x, through_y = 3 * row + guard, 4 * row + guard
    at_x = ROWS * row
    a, rising_x, falling_x = drift.own, drift.rising_x, drift.falling_x
    rising_y, falling_y = splat(drift.rising_y), splat(drift.falling_y)
    per_x, per_y, per_z = grid.per_spacing
    push_x, push_y, push_z = drift.push[0] * per_x, drift.push[1] * per_y, drift.push[2] * per_z
    old, weight_old, weight_new, dt = mix.old, mix.weight_old, mix.weight_new, mix.dt
    half_width = grid.half_width
    rises = (drift.rising_x, drift.falling_x, drift.rising_y, drift.falling_y)
    most = fastest_turning(drift.own, rises, half_width)
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
