"""div_xi (a g): the total drift in velocity space, and the update of a cell's block by all explicit terms.

a(xi) = - (A + xi_x . grad omega) xi + beta u, where A = d_t omega / omega + beta holds the scaling's own rate and the
drag's, so that the two cancel as numbers before anything is upwinded. The faces at the edge of the box are closed.
"""

from __future__ import annotations

from numba import njit

from rvm_mpi.simd import KERNEL, load, shifted, splat, store, upwind, van_leer3, where_positive
from rvm_mpi.velocity import Y_FACE, Y_OPEN, Y_SLOPE, Z_FACE, Z_OPEN, Z_SLOPE, Y

#: doubles of `scratch` needed in rows of a slab: zeros read before and after each row of a slab
SCRATCH_ROWS = 6


@njit(**KERNEL)
def update(  # type: ignore[no-untyped-def]
    g,
    cell,
    points,
    slab_size,
    x,
    x_face,
    slab,
    rates,
    old,
    weight_old,
    weight_new,
    dt,
    kappa,
    scratch,
    result,
):
    """result = weight_old * old + weight_new * (g + dt * (result + drift)) for the block of one cell.

    Parameters
    ----------
    g : (n,) array
        Blocks; this cell's begins at `cell`, which is also its offset in `old`.
    rates : (11,) array
        A, d_x omega for velocities that go up and down, d_y omega likewise, beta u_x, beta u_y, beta u_z, then 1/h of
        the three velocity directions.
    kappa : bool
        Reconstruct with the unlimited third-order upwind-biased parabola instead of Van Leer's limiter.
    scratch : (>= 6 (slab_size + 2 guard),) array
        Work space; zeros between its rows.
    result : (block,) array
        The rate of change by transport (`transport.py`); receives the new block.
    """
    points_x, points_y, points_z = points
    guard = points_z + 8
    row = slab_size + 2 * guard
    slope_x, slope_y, slope_z = guard, row + guard, 2 * row + guard
    through_x, through_y, slope_next = 3 * row + guard, 4 * row + guard, 5 * row + guard
    a, rising_x, falling_x, rising_y, falling_y = rates[0], rates[1], rates[2], splat(rates[3]), splat(rates[4])
    per_x, per_y, per_z = rates[8], rates[9], rates[10]
    push_x, push_y, push_z = rates[5] * per_x, rates[6] * per_y, rates[7] * per_z
    zero = splat(0.0)
    for n in range(0, slab_size, 8):
        store(scratch, slope_x + n, zero)
        store(scratch, through_x + n, zero)
    has_y, has_z = points_y > 1, points_z > 1
    mix_old = weight_old != 0.0
    sixth = 1.0 / 6.0
    for k in range(points_x):
        base = cell + k * slab_size
        at = k * slab_size
        xk, xf = x[k], x_face[k]
        along = a + (rising_x if xk > 0.0 else falling_x) * xk
        inside = 1.0 if k < points_x - 1 else 0.0
        sloped = 1.0 if k < points_x - 2 else 0.0
        sx0 = inside * per_x * (-(a + (rising_x if xf > 0.0 else falling_x) * xf) * xf) + inside * push_x
        sx1 = -inside * per_x * xf
        # slopes: of the next slab along x, of this one along y and z
        for n in range(0, slab_size, 8):
            c = load(g, base + n)
            next_x = load(g, base + slab_size + n)
            step, ahead = next_x - c, load(g, base + 2 * slab_size + n) - next_x
            down_y, up_y = c - load(g, base + n - points_z), load(g, base + n + points_z) - c
            down_z, up_z = c - load(g, base + n - 1), load(g, base + n + 1) - c
            if kappa:
                bend_x, bend_y, bend_z = (
                    (step - ahead) * sixth,
                    (down_y - up_y) * sixth,
                    (down_z - up_z) * sixth,
                )
            else:
                bend_x, bend_y, bend_z = van_leer3(step, ahead, down_y, up_y, down_z, up_z)
            store(scratch, slope_next + n, bend_x * sloped)
            store(scratch, slope_y + n, bend_y * load(slab, Y_SLOPE * slab_size + n))
            store(scratch, slope_z + n, bend_z * load(slab, Z_SLOPE * slab_size + n))
        before_z = zero
        for n in range(0, slab_size, 8):
            c = load(g, base + n)
            y = load(slab, Y * slab_size + n)
            r = load(result, at + n)

            up = load(g, base + slab_size + n)
            left, right = load(scratch, slope_x + n), load(scratch, slope_next + n)
            if kappa:
                middle = (c + up) * 0.5
                left, right = middle + left, middle + right
            else:
                left, right = c + left, up - right
            turn_y = y * where_positive(y, rising_y, falling_y)
            f = upwind(turn_y * sx1 + splat(sx0), left, right)
            r = r + (load(scratch, through_x + n) - f)
            store(scratch, through_x + n, f)

            if has_y:
                yf = load(slab, Y_FACE * slab_size + n)
                s = yf * (splat(-along) - yf * where_positive(yf, rising_y, falling_y)) * per_y + splat(push_y)
                s = s * load(slab, Y_OPEN * slab_size + n)
                up = load(g, base + n + points_z)
                left, right = load(scratch, slope_y + n), load(scratch, slope_y + n + points_z)
                if kappa:
                    middle = (c + up) * 0.5
                    left, right = middle + left, middle + right
                else:
                    left, right = c + left, up - right
                f = upwind(s, left, right)
                store(scratch, through_y + n, f)
                r = r + (load(scratch, through_y + n - points_z) - f)
            if has_z:
                zf = load(slab, Z_FACE * slab_size + n)
                s = zf * (splat(-along) - turn_y) * per_z + splat(push_z)
                s = s * load(slab, Z_OPEN * slab_size + n)
                up = load(g, base + n + 1)
                left, right = load(scratch, slope_z + n), load(scratch, slope_z + n + 1)
                if kappa:
                    middle = (c + up) * 0.5
                    left, right = middle + left, middle + right
                else:
                    left, right = c + left, up - right
                f = upwind(s, left, right)
                r = r + (shifted(before_z, f) - f)
                before_z = f
            r = c + r * dt
            if mix_old:
                r = r * weight_new + load(old, cell + at + n) * weight_old
            else:
                r = r * weight_new
            store(result, at + n, r)
        slope_x, slope_next = slope_next, slope_x
