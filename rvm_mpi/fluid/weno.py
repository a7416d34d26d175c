"""WENO5 reconstruction of a flux at a cell face.

The weights are those of WENO-Z with the exponent 2: R. Borges, M. Carmona, B. Costa, W. S. Don, J. Comput.
Phys. 227 (2008); M. Castro, B. Costa, W. S. Don, J. Comput. Phys. 230 (2011). They keep fifth order at simple
extrema, where the weights of Jiang and Shu fall to third, and depend on no scale of the solution: what keeps 0/0 out
of them is relative to the gas, not to the unit that its density is measured in.
"""

from __future__ import annotations

from rvm_mpi.compiling.declare import part

# No fused multiply-adds in the fluid's kernels: which product of a*b + c*d is fused is the compiler's choice, and would
# tell left from right and x from y in the last bit.

#: differences of this part of a field's natural size are none: far below rounding, so that a thin gas beside a dense
#: one still has weights of its own
FLAT = 1e-20


@part
def weno5(a, b, c, d, e, flat):  # type: ignore[no-untyped-def]
    """Value at the face between c and d of the function whose cell averages are a to e, upwind from the left.

    From the right: the same with the five cells in reverse order.

    Parameters
    ----------
    a, b, c, d, e : floats, or vectors of `simd.py`
        Averages over five consecutive cells.
    flat : float or vector
        A square, positive, below which the roughness of five averages is none; must not be that of the averages
        themselves, which may all be zero.

    Returns
    -------
    float or vector
    """
    from_a = (2.0 * a - 7.0 * b) + 11.0 * c
    from_b = (5.0 * c - b) + 2.0 * d
    from_c = (2.0 * c + 5.0 * d) - e
    bend_a, slope_a = (a - 2.0 * b) + c, (a - 4.0 * b) + 3.0 * c
    bend_b, slope_b = (b - 2.0 * c) + d, b - d
    bend_c, slope_c = (c - 2.0 * d) + e, (3.0 * c - 4.0 * d) + e
    rough_a = (13.0 / 12.0) * (bend_a * bend_a) + 0.25 * (slope_a * slope_a)
    rough_b = (13.0 / 12.0) * (bend_b * bend_b) + 0.25 * (slope_b * slope_b)
    rough_c = (13.0 / 12.0) * (bend_c * bend_c) + 0.25 * (slope_c * slope_c)
    difference = abs(rough_a - rough_c)
    ratio_a = difference / (rough_a + flat)
    ratio_b = difference / (rough_b + flat)
    ratio_c = difference / (rough_c + flat)
    weight_a = 1.0 + ratio_a * ratio_a
    weight_b = 6.0 * (1.0 + ratio_b * ratio_b)
    weight_c = 3.0 * (1.0 + ratio_c * ratio_c)
    combined = (weight_a * from_a + weight_b * from_b) + weight_c * from_c
    return combined / (6.0 * ((weight_a + weight_b) + weight_c))
