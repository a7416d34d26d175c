"""The discrete Gaussian: the positive grid function exp(quadratic in xi) with ten given moments.

The Gaussian sampled on a coarse velocity grid has wrong mass, momentum and second moments, so those of the discrete one
are met by Newton's method.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import exponential, fma, leading, load, minimum, splat, store, total, where_positive
from rvm_mpi.grid.velocity import VALID, Y, Z
from rvm_mpi.kinetic.conservation import about_origin, solve
from rvm_mpi.kinetic.realisable import TOO_COLD, determinant, invert_tensor, realisable_tensor

#: relative mismatch of the ten moments at which Newton's iteration rests
TOLERANCE = 2e-13
#: mismatch from which another step is not needed where it no longer falls
ACCEPTED = 1e-11
NEWTON_STEPS = 40
#: error of an axis's mean and variance from which one more step is the last
LAST_STEP = 3e-8
#: result of `discrete_gaussian` beside those of `realisable.py`: none was found
FAILED = 3

# exponents of (x, y, z) in 1, x, y, z, xx, xy, xz, yy, yz, zz
_EXPONENTS = np.array(
    [
        (0, 0, 0),
        (1, 0, 0),
        (0, 1, 0),
        (0, 0, 1),
        (2, 0, 0),
        (1, 1, 0),
        (1, 0, 1),
        (0, 2, 0),
        (0, 1, 1),
        (0, 0, 2),
    ],
    dtype=np.int64,
)
# the pairs (p, q) of exponents of y and z that occur with the powers 0..4 of x, and where their sums are kept
_PLANE = [(p, q) for p in range(5) for q in range(5 - p)]
_PLANE_EXPONENTS = np.array(_PLANE, dtype=np.int64)
_PLACE = np.full((5, 5), -1, dtype=np.int64)
for _index, (_p, _q) in enumerate(_PLANE):
    _PLACE[_p, _q] = _index
_PLANE_COUNT = len(_PLANE)
#: place in the (5, 15) table of sums of the product of two of the ten monomials
_PRODUCT = np.array(
    [[(a[0] + b[0]) * _PLANE_COUNT + _PLACE[a[1] + b[1], a[2] + b[2]] for b in _EXPONENTS] for a in _EXPONENTS],
    dtype=np.int64,
)


class Fit(NamedTuple):
    """Work space of `discrete_gaussian`.

    theta (10,), sums (75,), plane (600,), matrix (10, 10); step, wanted, scale (10,); axis (3,): a and b of one axis's
    Gaussian and its sum; inverse (6,).
    """

    theta: np.ndarray
    sums: np.ndarray
    plane: np.ndarray
    matrix: np.ndarray
    step: np.ndarray
    wanted: np.ndarray
    scale: np.ndarray
    axis: np.ndarray
    inverse: np.ndarray


class Gaussian(NamedTuple):
    """A discrete Gaussian: its values (block,), mean (3,), temperature tensor (6,) and sums (10,)."""

    block: np.ndarray
    mean: np.ndarray
    tensor: np.ndarray
    sums: np.ndarray


@part
def fit_axis(nodes, count, mean, variance, result):  # type: ignore[no-untyped-def]
    """exp(b s + a s^2), s = node - mean, with the given mean and variance on the nodes of one axis.

    Newton's method from the continuous Gaussian, or, where that is narrower than the grid, from the weights of the
    three nodes around the mean; `result` receives a, b and the sum over the nodes, of the best found.
    """
    a, b = -0.5 / variance, 0.0
    h = nodes[1] - nodes[0]
    nearest = min(max(int((mean - nodes[0]) / h + 0.5), 0), count - 1)
    off_node = mean - nodes[nearest]
    beside = (variance + off_node * off_node) / (h * h)
    above, below = 0.5 * (beside + off_node / h), 0.5 * (beside - off_node / h)
    if variance < 0.3 * h * h and 0 < nearest < count - 1 and beside < 1.0 and above > 0.0 and below > 0.0:
        a = math.log(above * below / (1.0 - beside) ** 2) / (2.0 * h * h)
        b = (math.log(above / below) + 4.0 * a * h * off_node) / (2.0 * h)
    result[0], result[1], result[2] = a, b, 1.0
    smallest = math.inf
    thermal = math.sqrt(variance)
    zero = splat(0.0)
    for _ in range(12):
        w0, w1, w2, w3, w4 = zero, zero, zero, zero, zero
        for j in range(0, count, 8):
            s = load(nodes, j) - splat(mean)
            w = leading(exponential(minimum(s * fma(s, a, splat(b)), splat(600.0))), count - j)
            w0 = w0 + w
            w = w * s
            w1 = w1 + w
            w = w * s
            w2 = w2 + w
            w = w * s
            w3 = w3 + w
            w4 = fma(w, s, w4)
        m0, m1, m2, m3, m4 = total(w0), total(w1), total(w2), total(w3), total(w4)
        if not (m0 > 0.0 and m0 < 1e300):
            return
        m1, m2, m3, m4 = m1 / m0, m2 / m0, m3 / m0, m4 / m0
        off = abs(m1) / thermal + abs(m2 / variance - 1.0)
        if off < smallest:
            smallest = off
            result[0], result[1], result[2] = a, b, m0
        if off < 1e-13:
            return
        # derivatives of (m1, m2) by (b, a) are covariances
        c11, c12, c22 = m2 - m1 * m1, m3 - m1 * m2, m4 - m2 * m2
        det = c11 * c22 - c12 * c12
        if not det > 0.0:
            return
        r1, r2 = -m1, variance - m2
        da = (c11 * r2 - c12 * r1) / det
        db = (c22 * r1 - c12 * r2) / det
        if off < LAST_STEP:
            # this step leaves an error of order off^2: no need to look again
            result[0], result[1], result[2] = a + da, b + db, m0 * (1.0 + m1 * db + m2 * da)
            return
        limit = 0.5 * max(abs(a), 0.5 / variance)
        shorter = 1.0 if abs(da) <= limit else limit / abs(da)
        a += shorter * da
        b += shorter * db


@part
def gaussian_moments(theta, centre, grid, block, moments):  # type: ignore[no-untyped-def]
    """block = exp(theta . m(xi - centre)), m = 1, x, y, z, xx, xy, xz, yy, yz, zz, and its sums of those ten.

    Along x the Gaussian is a product: from the node nearest to the centre outwards, one value follows from the one
    before by a ratio that itself changes by a constant ratio. So a slab costs three exponentials a node, not one
    for each x.
    """
    points_x, slab_size, x, slab = grid.points[0], grid.slab_size, grid.x, grid.slab
    zero = splat(0.0)
    h = x[1] - x[0]
    middle = min(max(int((centre[0] - x[0]) / h + 0.5), 0), points_x - 1)
    start = x[middle] - centre[0]
    curve = math.exp(2.0 * theta[4] * h * h)
    m0, mx, my, mz = zero, zero, zero, zero
    xx, xy, xz, yy, yz, zz = zero, zero, zero, zero, zero, zero
    for n in range(0, slab_size, 8):
        y = load(slab, Y * slab_size + n) - splat(centre[1])
        z = load(slab, Z * slab_size + n) - splat(centre[2])
        valid = load(slab, VALID * slab_size + n)
        along_y, along_z = fma(y, theta[7], splat(theta[2])), fma(y, theta[8], fma(z, theta[9], splat(theta[3])))
        base = fma(z, along_z, fma(y, along_y, splat(theta[0])))
        tilt = fma(z, theta[6], fma(y, theta[5], splat(theta[1])))
        exponent = fma(tilt + splat(theta[4] * start), start, base)
        # nothing where the start is below the range of doubles: from there the ratios would lead astray
        first = where_positive(exponent + splat(700.0), exponential(exponent), zero) * valid
        up = exponential(fma(tilt, h, splat(theta[4] * h * (2.0 * start + h))))
        down = exponential(fma(tilt, -h, splat(-theta[4] * h * (2.0 * start - h))))
        t = first * start
        a0, a1, a2 = first, t, t * start
        store(block, middle * slab_size + n, first)
        value = first
        for k in range(middle + 1, points_x):
            s = x[k] - centre[0]
            value = value * up
            up = up * curve
            store(block, k * slab_size + n, value)
            t = value * s
            a0 = a0 + value
            a1 = a1 + t
            a2 = fma(t, s, a2)
        value = first
        for k in range(middle - 1, -1, -1):
            s = x[k] - centre[0]
            value = value * down
            down = down * curve
            store(block, k * slab_size + n, value)
            t = value * s
            a0 = a0 + value
            a1 = a1 + t
            a2 = fma(t, s, a2)
        m0, mx, my, mz = m0 + a0, mx + a1, fma(a0, y, my), fma(a0, z, mz)
        xx, xy, xz = xx + a2, fma(a1, y, xy), fma(a1, z, xz)
        yy, yz, zz = fma(a0 * y, y, yy), fma(a0 * y, z, yz), fma(a0 * z, z, zz)
    moments[0], moments[1], moments[2], moments[3], moments[4] = total(m0), total(mx), total(my), total(mz), total(xx)
    moments[5], moments[6], moments[7], moments[8], moments[9] = total(xy), total(xz), total(yy), total(yz), total(zz)


@part
def gaussian_sums(centre, grid, block, sums, plane):  # type: ignore[no-untyped-def]
    """Sums to fourth order of the Gaussian that `gaussian_moments` has left in `block`.

    `sums` (5, 15) receives the sum of x^p y^q z^r at [p, place of (q, r)]; `plane` (75, 8) is work space.
    """
    points_x, slab_size, x, slab = grid.points[0], grid.slab_size, grid.x, grid.slab
    zero = splat(0.0)
    for q in range(75):
        store(plane, 8 * q, zero)
    for n in range(0, slab_size, 8):
        y = load(slab, Y * slab_size + n) - splat(centre[1])
        z = load(slab, Z * slab_size + n) - splat(centre[2])
        a0, a1, a2, a3, a4 = zero, zero, zero, zero, zero
        for k in range(points_x):
            s = x[k] - centre[0]
            value = load(block, k * slab_size + n)
            t = value * s
            a0 = a0 + value
            a1 = a1 + t
            t = t * s
            a2 = a2 + t
            t = t * s
            a3 = a3 + t
            a4 = fma(t, s, a4)
        w = splat(1.0)
        for p in range(5):
            t = w
            for q in range(5 - p):
                place = 8 * _PLACE[p, q]
                order = p + q
                store(plane, place, fma(a0, t, load(plane, place)))
                if order <= 3:
                    store(plane, 120 + place, fma(a1, t, load(plane, 120 + place)))
                if order <= 2:
                    store(plane, 240 + place, fma(a2, t, load(plane, 240 + place)))
                if order <= 1:
                    store(plane, 360 + place, fma(a3, t, load(plane, 360 + place)))
                if order == 0:
                    store(plane, 480 + place, fma(a4, t, load(plane, 480 + place)))
                t = t * z
            w = w * y
    for p in range(5):
        for q in range(15):
            if p + _PLANE_EXPONENTS[q, 0] + _PLANE_EXPONENTS[q, 1] <= 4:
                sums[15 * p + q] = total(load(plane, 8 * (15 * p + q)))


@part
def discrete_gaussian(density, mean, tensor, grid, work, block, moments):  # type: ignore[no-untyped-def]
    """The positive grid function exp(quadratic) with the given sums, mean and temperature tensor.

    Parameters
    ----------
    density : float
        The sum over the nodes (not yet multiplied by the volume of a velocity cell).
    mean : (3,) array
        Mean of xi.
    tensor : (6,) array
        Covariance xx, xy, xz, yy, yz, zz; replaced by the nearest one that the grid can hold where it must be.
    grid : data.Grid
    work : Fit
    block : (points_x * slab_size,) array
        Receives the Gaussian.
    moments : (10,) array
        Receives its sums of 1, xi, xi xi about the origin, as they are.

    Returns
    -------
    int
        EXACT, REPLACED, TOO_COLD or FAILED.
    """
    dimensions, points, nodes = grid.dimensions, grid.points, grid.nodes
    theta, sums, matrix = work.theta, work.sums, work.matrix
    step, wanted, scale, fit, inverse = work.step, work.wanted, work.scale, work.axis, work.inverse
    status = realisable_tensor(mean, tensor, grid)
    if status == TOO_COLD:
        return TOO_COLD
    if not invert_tensor(tensor, dimensions, inverse):
        return FAILED
    diagonal = (0, 3, 5)
    for i in range(10):
        theta[i] = 0.0
    theta[4], theta[5], theta[6] = -0.5 * inverse[0], -inverse[1], -inverse[2]
    theta[7], theta[8], theta[9] = -0.5 * inverse[3], -inverse[4], -0.5 * inverse[5]
    # on each axis what its own grid needs; the determinants give the sum of the correlated Gaussian
    theta[0] = math.log(density)
    for i in range(dimensions):
        variance = tensor[diagonal[i]]
        fit_axis(nodes[i], points[i], mean[i], variance, fit)
        place = 4 if i == 0 else (7 if i == 1 else 9)
        theta[place] += fit[0] + 0.5 / variance
        theta[1 + i] = fit[1]
        theta[0] -= math.log(fit[2]) - 0.5 * math.log(variance)
    theta[0] -= 0.5 * math.log(determinant(tensor, dimensions))
    wanted[0] = density
    wanted[1], wanted[2], wanted[3] = 0.0, 0.0, 0.0
    scale[0] = density
    for i in range(3):
        scale[1 + i] = density * math.sqrt(tensor[diagonal[i]]) if i < dimensions else 1.0
    for i in range(6):
        wanted[4 + i] = density * tensor[i]
    scale[4] = scale[1] * scale[1] / density
    scale[5] = scale[1] * scale[2] / density
    scale[6] = scale[1] * scale[3] / density
    scale[7] = scale[2] * scale[2] / density
    scale[8] = scale[2] * scale[3] / density
    scale[9] = scale[3] * scale[3] / density
    previous = math.inf
    damping = 1.0
    for _ in range(NEWTON_STEPS):
        gaussian_moments(theta, mean, grid, block, moments)
        mismatch = 0.0
        for i in range(10):
            step[i] = wanted[i] - moments[i]
            mismatch = max(mismatch, abs(step[i]) / scale[i])
        if not mismatch < 1e200:
            return FAILED
        if mismatch <= TOLERANCE or (mismatch <= ACCEPTED and mismatch >= 0.5 * previous):
            about_origin(moments, mean)
            return status
        damping = 0.5 * damping if mismatch > previous else min(1.0, 2.0 * damping)
        previous = mismatch
        gaussian_sums(mean, grid, block, sums, work.plane)
        for i in range(10):
            for j in range(i + 1):
                matrix[i, j] = sums[_PRODUCT[i, j]]
        if not solve(matrix, step, 10):
            return FAILED
        reach = abs(step[0])
        for i in range(1, 10):
            reach += 3.0 * abs(step[i]) * scale[i] / density
        shorter = damping if reach <= 3.0 else damping * 3.0 / reach
        for i in range(10):
            theta[i] += shorter * step[i]
    return FAILED


@part
def discrete_maxwellian(density, temperature, gaussian, grid, work):  # type: ignore[no-untyped-def]
    """`discrete_gaussian` of one temperature, in a `Gaussian` whose mean is given."""
    for q in range(6):
        gaussian.tensor[q] = 0.0
    for q in range(grid.dimensions):
        gaussian.tensor[(0, 3, 5)[q]] = temperature
    return discrete_gaussian(density, gaussian.mean, gaussian.tensor, grid, work, gaussian.block, gaussian.sums)
