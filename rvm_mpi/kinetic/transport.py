"""div_x (omega xi g): Van Leer's upwind fluxes through the faces between cells.

A face flux is kept as the block omega_face xi_n g_face / h, a rate; its moments (1, xi, |xi|^2) come with it, for they
carry mass, momentum and energy across the face (`conservation.py`). g is reconstructed upwind with Van Leer's harmonic
limiter, which keeps g >= 0 for a Courant number up to one half in all directions together.
"""

from __future__ import annotations

from numba import njit

from rvm_mpi.simd import KERNEL, load, prefetch, splat, store, total, van_leer, where_positive
from rvm_mpi.velocity import Y, Z


@njit(**KERNEL)
def flux_x(g, lower, stride, points_x, slab_size, x, slab, speed, flux, moments):  # type: ignore[no-untyped-def]
    """The flux through a face normal to x.

    Parameters
    ----------
    g : (n,) array
        Blocks of cells; `lower` is the offset of the cell below the face, `stride` that to the next one along x.
    speed : float
        omega at the face over the cell's width.
    flux : (block,) array
        Receives speed * xi_x * g at the face.
    moments : (5,) array
        Receives the sums of flux times 1, xi_x, xi_y, xi_z, |xi|^2.
    """
    zero = splat(0.0)
    m0, mx, my, mz, m2 = zero, zero, zero, zero, zero
    for k in range(points_x):
        xk = x[k]
        rate = speed * xk
        base = lower + k * slab_size
        if xk > 0.0:
            here, behind, ahead = base, base - stride, base + stride
        else:
            here, behind, ahead = base + stride, base + 2 * stride, base
        s0, sy, sz, s2 = zero, zero, zero, zero
        for n in range(0, slab_size, 8):
            u = load(g, here + n)
            f = (u + van_leer(u - load(g, behind + n), load(g, ahead + n) - u)) * rate
            prefetch(g, base + 3 * stride + n)
            store(flux, k * slab_size + n, f)
            y = load(slab, Y * slab_size + n)
            z = load(slab, Z * slab_size + n)
            fy, fz = f * y, f * z
            s0 = s0 + f
            sy = sy + fy
            sz = sz + fz
            s2 = s2 + (fy * y + fz * z)
        m0 = m0 + s0
        mx = mx + s0 * xk
        my = my + sy
        mz = mz + sz
        m2 = m2 + (s2 + s0 * (xk * xk))
    moments[0], moments[1], moments[2], moments[3], moments[4] = total(m0), total(mx), total(my), total(mz), total(m2)


@njit(**KERNEL)
def flux_y(g, lower, stride, points_x, slab_size, below, x, slab, speed, flux, moments):  # type: ignore[no-untyped-def]
    """The flux through a face normal to y; `below` counts the slab nodes with xi_y < 0 or, for one row, = 0.

    Parameters and results are those of `flux_x`, with `stride` the offset to the next cell along y.
    """
    zero = splat(0.0)
    m0, mx, my, mz, m2 = zero, zero, zero, zero, zero
    for k in range(points_x):
        xk = x[k]
        base = lower + k * slab_size
        s0, sy, sz, s2 = zero, zero, zero, zero
        for n in range(0, slab_size, 8):
            y = load(slab, Y * slab_size + n)
            z = load(slab, Z * slab_size + n)
            down = load(g, base + n)
            up = load(g, base + stride + n)
            difference = up - down
            if n >= below:
                face = down + van_leer(down - load(g, base - stride + n), difference)
            elif n + 8 <= below:
                face = up - van_leer(difference, load(g, base + 2 * stride + n) - up)
            else:
                from_down = down + van_leer(down - load(g, base - stride + n), difference)
                from_up = up - van_leer(difference, load(g, base + 2 * stride + n) - up)
                face = where_positive(y, from_down, from_up)
            prefetch(g, base + 2 * stride + slab_size * points_x + n)
            f = face * (y * speed)
            store(flux, k * slab_size + n, f)
            fy, fz = f * y, f * z
            s0 = s0 + f
            sy = sy + fy
            sz = sz + fz
            s2 = s2 + (fy * y + fz * z)
        m0 = m0 + s0
        mx = mx + s0 * xk
        my = my + sy
        mz = mz + sz
        m2 = m2 + (s2 + s0 * (xk * xk))
    moments[0], moments[1], moments[2], moments[3], moments[4] = total(m0), total(mx), total(my), total(mz), total(m2)
