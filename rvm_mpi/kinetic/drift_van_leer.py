"""The drift's fluxes by Van Leer's limiter on g: the paper's, positive up to a Courant number of one half."""

from __future__ import annotations

import math

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import fma, load, prefetch, shifted, splat, store, upwind, where_positive
from rvm_mpi.grid.velocity import LEAST, Y_FACE, Y_LEAST, Y_OPEN, Z_FACE, Z_LEAST, Z_OPEN, Y
from rvm_mpi.kinetic.drift_speed import guard_of
from rvm_mpi.kinetic.limiter import van_leer3

#: rows of a slab that the work space holds
ROWS = 9
#: nodes of a slab, at most, that are updated for every xi_x before the next: what belongs to them stays in the nearest
#: cache
PIECE = 256


@part
def whole_vectors(count):  # type: ignore[no-untyped-def]
    """The count rounded up to whole vectors."""
    return (count + 7) // 8 * 8


@part
def _piece(points_z):  # type: ignore[no-untyped-def]
    """Nodes of a piece: whole vectors and whole rows along z, so that no flux along z crosses into the next."""
    step = points_z
    while step % 8 != 0:
        step += points_z
    return max(PIECE // step, 1) * step


@part
def update_van_leer(g, cell, grid, drift, mix, scratch, result):  # type: ignore[no-untyped-def]
    """`drift.apply` with this reconstruction."""
    points_x, points_y, points_z = grid.points
    slab_size, x, x_face, slab = grid.slab_size, grid.x, grid.x_face, grid.slab
    guard = guard_of(points_z)
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
    piece, above = _piece(points_z), whole_vectors(points_z)
    for begin in range(0, slab_size, piece):
        end = min(begin + piece, slab_size)
        # fluxes along y from this piece to the next, for one xi_x after the other
        between = ROWS * row
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
                bend_x, bend_y, bend_z = van_leer3(
                    (step, ahead, least_x), (down_y, up_y, least_y), (down_z, up_z, least_z)
                )
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
