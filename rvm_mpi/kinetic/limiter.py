"""Limiters: values on a face, of transport in x and of the drift relative to the Maxwellian; Van Leer's slopes.

A face's value is the upwind-biased u + (2 b + a)/6 of third order, a and b the differences behind u and ahead of it,
within u + a and u + b where these lie on one side (Koren's limiter), and u where they do not; these bounds are widened
to (1 - ROOM) u and (1 + ROOM) u where that is more. No division; where all values are positive the face's is between 0
and 2 u, and so g >= 0 up to a Courant number of one half in all directions together.
"""

from __future__ import annotations

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import fma, maximum, minimum, splat, where_above

#: what a face's value may leave the upwind one by anyway, over the latter: keeps the third order at smooth extrema, and
#: with none rounding grows where g is steep (a disc on 32 x 32 cells was asymmetric by 1e-5), for Koren's bounds alone
#: take the downwind value there; more makes a front ring
ROOM = 0.02
#: bounds of the drift's value on a face in differences behind the upwind node and ahead of it. On an exponential the
#: value is the geometric mean: where h rises tenfold it adds 2.4 of the former, where it falls so 0.76 of the latter.
#: Less of the latter smears fronts: with 0.5 the velocity in Test 5's slab is twice as far off
EXPONENTIAL, SHARPEST = 2.0, 1.0
_THIRD, _SIXTH = 1.0 / 3.0, 1.0 / 6.0


@part
def face_value(u, a, b):  # type: ignore[no-untyped-def]
    """The value on the face ahead of u, a and b the differences behind it and ahead of it; vectors."""
    room = abs(u) * ROOM
    high = maximum(room, minimum(a, b))
    low = minimum(splat(0.0) - room, maximum(a, b))
    return u + maximum(low, minimum(high, fma(b, splat(_THIRD), a * _SIXTH)))


@part
def face_number(u, a, b, free):  # type: ignore[no-untyped-def]
    """`face_value` of numbers, the same to the last bit where `free` is ROOM; with 0 Koren's bounds alone."""
    room = abs(u) * free
    high = max(room, min(a, b))
    low = min(-room, max(a, b))
    return u + max(low, min(high, fma(b, _THIRD, a * _SIXTH)))


@part
def van_leer3(along_x, along_y, along_z):  # type: ignore[no-untyped-def]
    """Half of Van Leer's slopes along three directions, a b/(a + b), for one division; zero where a b <= least.

    Each direction is (a, b, least): the differences on both sides, and `grid.velocity.LEAST` or more, below which the
    product of the three denominators could leave the range of doubles.
    """
    a1, b1, least1 = along_x
    a2, b2, least2 = along_y
    a3, b3, least3 = along_z
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
def towards_face(upwind, ahead):  # type: ignore[no-untyped-def]
    """Eight times what a face's value adds to the upwind node's, of the differences behind that node and ahead of it.

    The parabola through three nodes, within EXPONENTIAL and SHARPEST of them where they agree in sign; else zero.
    """
    zero = splat(0.0)
    most, steepest = upwind * (8.0 * EXPONENTIAL), ahead * (8.0 * SHARPEST)
    low, high = maximum(minimum(most, steepest), zero), minimum(maximum(most, steepest), zero)
    return maximum(minimum(fma(ahead, splat(3.0), upwind), low), high)
