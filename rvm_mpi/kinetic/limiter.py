"""Slopes limited on vectors: Van Leer's, in three forms that differ in what they cost beside other work, and MC."""

from __future__ import annotations

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import fma, maximum, minimum, rough_inverse, splat, where_above, where_positive


@part
def van_leer(a, b):  # type: ignore[no-untyped-def]
    """Half of Van Leer's slope of the differences a, b: a b/(a + b) where they agree in sign, else 0."""
    product = a * b
    return where_positive(product, product / (a + b), splat(0.0))


@part
def van_leer_newton(a, b):  # type: ignore[no-untyped-def]
    """`van_leer` to two units in the last place without a division, to be worked out beside one.

    A processor divides vectors slowly, but goes on multiplying meanwhile.
    """
    product, total = a * b, a + b
    minus = splat(0.0) - total
    one = splat(1.0)
    inverse = rough_inverse(total)
    error = fma(minus, inverse, one)
    inverse = fma(inverse, fma(error, error, error), inverse)
    error = fma(minus, inverse, one)
    inverse = fma(inverse, fma(error, error, error), inverse)
    inverse = fma(inverse, fma(minus, inverse, one), inverse)
    return where_positive(product, product * inverse, splat(0.0))


@part
def van_leer3(a1, b1, least1, a2, b2, least2, a3, b3, least3):  # type: ignore[no-untyped-def]
    """Three slopes of `van_leer` for one division; zero where the product of differences is not above `least`.

    `least` is `grid.velocity.LEAST` or more: below it the product of the three denominators could leave the range of
    doubles.
    """
    zero, one = splat(0.0), splat(1.0)
    p1, p2, p3 = a1 * b1, a2 * b2, a3 * b3
    n1, d1 = where_above(p1, least1, p1, zero), where_above(p1, least1, a1 + b1, one)
    n2, d2 = where_above(p2, least2, p2, zero), where_above(p2, least2, a2 + b2, one)
    n3, d3 = where_above(p3, least3, p3, zero), where_above(p3, least3, a3 + b3, one)
    d12 = d1 * d2
    inverse = one / (d12 * d3)
    rest = d3 * inverse
    return (n1 * d2) * rest, (n2 * d1) * rest, n3 * (d12 * inverse)


@part
def monotonised(a, b, quarter):  # type: ignore[no-untyped-def]
    """Half of the monotonised central slope of the differences a, b: minmod(a, b, (a + b)/4), without a division.

    `quarter` is 1/4, or 0 where there is to be no slope.
    """
    zero = splat(0.0)
    low, high = maximum(minimum(a, b), zero), minimum(maximum(a, b), zero)
    return maximum(minimum((a + b) * quarter, low), high)
