"""Moments of a block, and the correction of g that makes its mass, momentum and energy exact.

Where g is positive the correction multiplies it by exp(c0 + c . (xi - u) + c2 |xi - u|^2): positive, and a product of
factors of one axis each. Its d + 2 coefficients come from a few Newton steps on the moments themselves. A g that a
spectral operator has left negative in places has no such factor; there a Gaussian times such a polynomial is added.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import exponential, first_lane, fma, load, splat, spread, store, total
from rvm_mpi.grid.velocity import Y, Z

#: sums kept of a block: 1, x, y, z, xx, xy, xz, yy, yz, zz, x|xi|^2, y|xi|^2, z|xi|^2, |xi|^4
SUMS = 14
#: relative mismatch of the moments at which Newton's iteration rests
TOLERANCE = 1e-13
#: mismatch from which one more step is the last: what it leaves is its square
LAST_STEP = 1e-8
NEWTON_STEPS = 40


class Correction(NamedTuple):
    """The factor that corrects a block, as a product, and work space.

    Attributes
    ----------
    factor_x, factor_slab : (points_x,), (slab_size,) arrays
        What the block is to be multiplied by for xi_x and for (xi_y, xi_z).
    powers : (5 points_x,) array
    matrix : (5, 5) array
    centre, coefficients, step : (3,), (5,), (5,) arrays
    """

    factor_x: np.ndarray
    factor_slab: np.ndarray
    powers: np.ndarray
    matrix: np.ndarray
    centre: np.ndarray
    coefficients: np.ndarray
    step: np.ndarray

    @classmethod
    def ones(cls, grid: Any) -> Correction:
        """The factor one, for a grid."""
        points, slab_size = grid.points[0], grid.slab_size
        vectors = np.zeros(3), np.zeros(5), np.zeros(5)
        return cls(np.ones(points), np.ones(slab_size), np.zeros(5 * points), np.zeros((5, 5)), *vectors)


@part
def no_factor(work):  # type: ignore[no-untyped-def]
    """Set the factor to one."""
    for k in range(work.factor_x.size):
        work.factor_x[k] = 1.0
    for n in range(0, work.factor_slab.size, 8):
        store(work.factor_slab, n, splat(1.0))


@part
def solve(matrix, vector, n):  # type: ignore[no-untyped-def]
    """Solve a symmetric positive system in place (Cholesky); rows with a zero diagonal are left out.

    Returns False where the matrix is not positive.
    """
    for i in range(n):
        if matrix[i, i] == 0.0:
            matrix[i, i] = 1.0
            vector[i] = 0.0
    for j in range(n):
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if not pivot > 0.0:
            return False
        pivot = math.sqrt(pivot)
        matrix[j, j] = pivot
        for i in range(j + 1, n):
            s = matrix[i, j]
            for k in range(j):
                s -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = s / pivot
        s = vector[j]
        for k in range(j):
            s -= matrix[j, k] * vector[k]
        vector[j] = s / pivot
    for j in range(n - 1, -1, -1):
        s = vector[j]
        for k in range(j + 1, n):
            s -= matrix[k, j] * vector[k]
        vector[j] = s / matrix[j, j]
    return True


@part
def factor_tables(grid, work):  # type: ignore[no-untyped-def]
    """The factor exp(c0 + c . (xi - u) + c2 |xi - u|^2) of the coefficients (c0, c, c2), about the centre u."""
    centre, coefficients, x, slab, slab_size = work.centre, work.coefficients, grid.x, grid.slab, grid.slab_size
    c0, cx, cy, cz, c2 = coefficients[0], coefficients[1], coefficients[2], coefficients[3], coefficients[4]
    for k in range(grid.points[0]):
        s = x[k] - centre[0]
        work.factor_x[k] = first_lane(exponential(splat(s * (cx + c2 * s))))
    for n in range(0, slab_size, 8):
        y = load(slab, Y * slab_size + n) - splat(centre[1])
        z = load(slab, Z * slab_size + n) - splat(centre[2])
        along_y, along_z = fma(y, c2, splat(cy)), fma(z, c2, splat(cz))
        store(work.factor_slab, n, exponential(fma(y, along_y, fma(z, along_z, splat(c0)))))


@part
def _add_planes(planes, f, y, z, sums_of_x):  # type: ignore[no-untyped-def]
    """Add to the sums of `weighted_sums` those of f at (y, z), from its sums times x^0 to x^4."""
    a0, a1, a2, a3, a4 = sums_of_x
    m0, mx, my, mz, xx, xy, xz, yy, yz, zz, x3, y3, z3, m4 = planes
    fy, fz = f * y, f * z
    square = fma(y, y, z * z)
    radial = fma(square, a0, a2)
    return (
        fma(f, a0, m0),
        fma(f, a1, mx),
        fma(fy, a0, my),
        fma(fz, a0, mz),
        fma(f, a2, xx),
        fma(fy, a1, xy),
        fma(fz, a1, xz),
        fma(fy * y, a0, yy),
        fma(fy * z, a0, yz),
        fma(fz * z, a0, zz),
        fma(f, fma(square, a1, a3), x3),
        fma(fy, radial, y3),
        fma(fz, radial, z3),
        fma(f, fma(square, a2 + radial, a4), m4),
    )


@part
def weighted_sums(block, centre, grid, work, sums):  # type: ignore[no-untyped-def]
    """The sums of a block times the factor in `work` about `centre`, in the order of `SUMS`."""
    points_x, slab_size, x, slab = grid.points[0], grid.slab_size, grid.x, grid.slab
    factor_x, factor_slab, powers = work.factor_x, work.factor_slab, work.powers
    for k in range(points_x):
        s = x[k] - centre[0]
        f = factor_x[k]
        for p in range(5):
            powers[5 * k + p] = f
            f = f * s
    zero = splat(0.0)
    planes = (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero, zero)
    # two vectors of the plane at a time, for the processor to work on one while the sums of the other are on their way;
    # where their number is odd the last one is paired with itself, once without weight
    for n in range(0, slab_size, 16):
        m = min(n + 8, slab_size - 8)
        a0, a1, a2, a3, a4 = zero, zero, zero, zero, zero
        b0, b1, b2, b3, b4 = zero, zero, zero, zero, zero
        for k in range(points_x):
            a, b = load(block, k * slab_size + n), load(block, k * slab_size + m)
            w = spread(powers, 5 * k)
            a0, b0 = fma(a, w, a0), fma(b, w, b0)
            w = spread(powers, 5 * k + 1)
            a1, b1 = fma(a, w, a1), fma(b, w, b1)
            w = spread(powers, 5 * k + 2)
            a2, b2 = fma(a, w, a2), fma(b, w, b2)
            w = spread(powers, 5 * k + 3)
            a3, b3 = fma(a, w, a3), fma(b, w, b3)
            w = spread(powers, 5 * k + 4)
            a4, b4 = fma(a, w, a4), fma(b, w, b4)
        y, z = load(slab, Y * slab_size + n) - splat(centre[1]), load(slab, Z * slab_size + n) - splat(centre[2])
        planes = _add_planes(planes, load(factor_slab, n), y, z, (a0, a1, a2, a3, a4))
        y, z = load(slab, Y * slab_size + m) - splat(centre[1]), load(slab, Z * slab_size + m) - splat(centre[2])
        planes = _add_planes(planes, load(factor_slab, m) * (1.0 if m > n else 0.0), y, z, (b0, b1, b2, b3, b4))
    m0, mx, my, mz, xx, xy, xz, yy, yz, zz, x3, y3, z3, m4 = planes
    sums[0], sums[1], sums[2], sums[3] = total(m0), total(mx), total(my), total(mz)
    sums[4], sums[5], sums[6] = total(xx), total(xy), total(xz)
    sums[7], sums[8], sums[9] = total(yy), total(yz), total(zz)
    sums[10], sums[11], sums[12], sums[13] = total(x3), total(y3), total(z3), total(m4)


@part
def about_origin(sums, centre):  # type: ignore[no-untyped-def]
    """Turn the first ten sums about `centre` into sums about the origin, in place."""
    m, cx, cy, cz = sums[0], centre[0], centre[1], centre[2]
    mx, my, mz = sums[1], sums[2], sums[3]
    sums[4] += cx * (2.0 * mx + cx * m)
    sums[5] += cx * my + cy * mx + cx * cy * m
    sums[6] += cx * mz + cz * mx + cx * cz * m
    sums[7] += cy * (2.0 * my + cy * m)
    sums[8] += cy * mz + cz * my + cy * cz * m
    sums[9] += cz * (2.0 * mz + cz * m)
    sums[1] += cx * m
    sums[2] += cy * m
    sums[3] += cz * m


@part
def _moment_matrix(sums, matrix):  # type: ignore[no-untyped-def]
    """Lower half of the sums of products of 1, c, |c|^2, from those of `weighted_sums`."""
    for i in range(3):
        matrix[1 + i, 0] = sums[1 + i]
        matrix[4, 1 + i] = sums[10 + i]
    matrix[0, 0] = sums[0]
    matrix[4, 0] = sums[4] + sums[7] + sums[9]
    matrix[1, 1], matrix[2, 1], matrix[3, 1] = sums[4], sums[5], sums[6]
    matrix[2, 2], matrix[3, 2], matrix[3, 3] = sums[7], sums[8], sums[9]
    matrix[4, 4] = sums[13]


@part
def relative_mismatch(sums, density, thermal, spread):  # type: ignore[no-untyped-def]
    """How far sums about the mean wanted are from density, zero momentum and spread, relative, the largest."""
    return max(
        abs(sums[0] / density - 1.0),
        max(abs(sums[1]), abs(sums[2]), abs(sums[3])) / (density * thermal),
        abs((sums[4] + sums[7] + sums[9]) / spread - 1.0),
    )


@part
def correct(block, target, grid, work, sums):  # type: ignore[no-untyped-def]
    """Find the factor that gives a block the moments `target`.

    Parameters
    ----------
    block : (points_x * slab_size,) array
        Not changed; multiply it by `work.factor_x` and `work.factor_slab`.
    target : (5,) array
        Sums of 1, xi, |xi|^2/2 wanted.
    grid : data.Grid
    work : Correction
    sums : (14,) array
        Receives the first ten sums of the corrected block about the origin.

    Returns
    -------
    float
        The largest relative mismatch found before the correction, -1 where Newton's iteration failed.
    """
    centre, coefficients, step, matrix = work.centre, work.coefficients, work.step, work.matrix
    density = target[0]
    for i in range(3):
        centre[i] = target[1 + i] / density
    speed2 = centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2
    spread = 2.0 * target[4] - density * speed2
    if not (density > 0.0 and spread > 0.0):
        return -1.0
    thermal = math.sqrt(spread / density)
    for i in range(5):
        coefficients[i] = 0.0
    no_factor(work)
    first = 0.0
    previous = math.inf
    for attempt in range(NEWTON_STEPS):
        weighted_sums(block, centre, grid, work, sums)
        square = sums[4] + sums[7] + sums[9]
        mismatch = relative_mismatch(sums, density, thermal, spread)
        if attempt == 0:
            first = mismatch
        if attempt > 0 and previous > LAST_STEP and not mismatch < previous:
            # too far: half of the step
            for i in range(5):
                step[i] *= 0.5
                coefficients[i] -= step[i]
            factor_tables(grid, work)
            continue
        if not mismatch < 1e100:
            return -1.0
        if mismatch <= TOLERANCE or (attempt > 2 and mismatch < 1e-11 and mismatch >= previous):
            about_origin(sums, centre)
            return first
        previous = mismatch
        _moment_matrix(sums, matrix)
        step[0] = density - sums[0]
        step[1], step[2], step[3] = -sums[1], -sums[2], -sums[3]
        step[4] = spread - square
        if not solve(matrix, step, 5):
            return -1.0
        # far from the answer a full Newton step may overshoot: none changes by more than e^2 at 3 thermal speeds
        reach = (
            abs(step[0])
            + 3.0 * thermal * (abs(step[1]) + abs(step[2]) + abs(step[3]))
            + 9.0 * thermal**2 * abs(step[4])
        )
        shorter = 1.0 if reach <= 2.0 else 2.0 / reach
        for i in range(5):
            step[i] *= shorter
            coefficients[i] += step[i]
        factor_tables(grid, work)
        if mismatch <= LAST_STEP:
            # this step leaves a mismatch of order mismatch^2: no need to look again
            sums[0], sums[1], sums[2], sums[3] = density, 0.0, 0.0, 0.0
            share = (spread - square) / grid.dimensions
            for i in range(grid.dimensions):
                sums[4 if i == 0 else (7 if i == 1 else 9)] += share
            about_origin(sums, centre)
            return first
    return -1.0


@part
def add_correction(block, gaussian, target, grid, work, sums):  # type: ignore[no-untyped-def]
    """Add gaussian * (c0 + c . (xi - u) + c2 |xi - u|^2) to a block of any sign, so that its moments are `target`.

    Parameters
    ----------
    block : (points_x * slab_size,) array
        Corrected in place.
    gaussian : (points_x * slab_size,) array
        Positive, best with moments near the target's.
    target, grid, work, sums
        As in `correct`; the factor is left at one.

    Returns
    -------
    float
        The largest relative mismatch of the moments that was removed, -1 where the target is not positive.
    """
    points_x, slab_size, x, slab = grid.points[0], grid.slab_size, grid.x, grid.slab
    centre, step, matrix = work.centre, work.step, work.matrix
    density = target[0]
    for i in range(3):
        centre[i] = target[1 + i] / density
    spread = 2.0 * target[4] - density * (centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2)
    if not (density > 0.0 and spread > 0.0):
        return -1.0
    thermal = math.sqrt(spread / density)
    no_factor(work)
    weighted_sums(block, centre, grid, work, sums)
    square = sums[4] + sums[7] + sums[9]
    mismatch = relative_mismatch(sums, density, thermal, spread)
    step[0], step[1], step[2], step[3] = density - sums[0], -sums[1], -sums[2], -sums[3]
    step[4] = spread - square
    weighted_sums(gaussian, centre, grid, work, sums)
    _moment_matrix(sums, matrix)
    if not solve(matrix, step, 5):
        return -1.0
    for k in range(points_x):
        s = x[k] - centre[0]
        along = step[0] + s * (step[1] + step[4] * s)
        for n in range(0, slab_size, 8):
            y = load(slab, Y * slab_size + n) - splat(centre[1])
            z = load(slab, Z * slab_size + n) - splat(centre[2])
            along_y, along_z = fma(y, step[4], splat(step[2])), fma(z, step[4], splat(step[3]))
            polynomial = fma(y, along_y, fma(z, along_z, splat(along)))
            at = k * slab_size + n
            store(block, at, fma(load(gaussian, at), polynomial, load(block, at)))
    weighted_sums(block, centre, grid, work, sums)
    about_origin(sums, centre)
    return mismatch
