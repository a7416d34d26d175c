"""Sums over cells and ranks that do not depend on their order.

A float64 is an integer times 2^-1074. Each sum is kept as one long integer in limbs of 32 bits (a
superaccumulator): integer additions are associative, so the result is the same for every split of the cells
over ranks, and the one rounding at the end makes it the correctly rounded exact sum, as `math.fsum` gives
for one process.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.compiling.declare import kernel

if TYPE_CHECKING:
    from mpi4py import MPI

# 2098 bits from the smallest subnormal to the largest double, 31 bits for the count of terms, and the sign.
LIMBS = 68
LIMB_BITS = 32
# One addition changes a limb by less than 2^33, so an int64 limb holds 2^30 of them.
MOST_TERMS = 2**30
_UNIT = 1 << 1074


@kernel
def _accumulate(bits, limbs, first):
    """Add the columns of float64 values, given as their bit patterns, to the rows `limbs[first:]`.

    Parameters
    ----------
    bits : int64 array (n, m)
    limbs : int64 array (quantities, LIMBS + 1); the last column counts terms that are not finite.
    first : int
    """
    n, m = bits.shape
    low_bits = np.int64(0xFFFFFFFF)
    for i in range(n):
        for q in range(m):
            pattern = bits[i, q]
            exponent = (pattern >> 52) & 0x7FF
            significand = pattern & ((np.int64(1) << 52) - 1)
            if exponent == 0x7FF:
                limbs[first + q, LIMBS] += 1
                continue
            if exponent != 0:
                significand |= np.int64(1) << 52
                exponent -= 1
            limb = exponent >> 5
            shift = exponent & 31
            low = (significand & low_bits) << shift
            high = (significand >> 32) << shift
            part0 = low & low_bits
            part1 = (low >> 32) + (high & low_bits)
            part2 = high >> 32
            if pattern < 0:
                part0, part1, part2 = -part0, -part1, -part2
            limbs[first + q, limb] += part0
            limbs[first + q, limb + 1] += part1
            limbs[first + q, limb + 2] += part2


@kernel
def _carry(limbs):
    """Bring all limbs but the topmost into [0, 2^32); the topmost keeps the sign (two's complement)."""
    for q in range(limbs.shape[0]):
        carry = np.int64(0)
        for k in range(LIMBS - 1):
            total = limbs[q, k] + carry
            carry = total >> 32
            limbs[q, k] = total & 0xFFFFFFFF
        limbs[q, LIMBS - 1] += carry


def exact_sums(arrays: np.ndarray | Sequence[np.ndarray], comm: MPI.Comm | None = None) -> np.ndarray:
    """Correctly rounded sums over all cells of all ranks, the same bits for any order and any split.

    Parameters
    ----------
    arrays : this rank's share, possibly empty: an ndarray (cells, quantities), summed over its first axis,
        or a sequence of arrays of any shapes, each summed over all its entries; converted to float64
    comm : MPI communicator, or None for this process alone; one Allreduce of int64 for all quantities

    Returns
    -------
    ndarray (quantities,) : NaN where a term anywhere is NaN or infinite, +-inf where the sum overflows.

    Raises
    ------
    ValueError : an ndarray that has not two axes, or 2^30 terms or more on one rank.
    """
    if isinstance(arrays, np.ndarray):
        if arrays.ndim != 2:
            raise ValueError(f"an array to sum must be (cells, quantities), not of shape {arrays.shape}")
        columns = [arrays]
        quantities = arrays.shape[1]
    else:
        columns = [np.reshape(array, (-1, 1)) for array in arrays]
        quantities = len(columns)

    limbs = np.zeros((quantities, LIMBS + 1), dtype=np.int64)
    first = 0
    for block in columns:
        if block.shape[0] >= MOST_TERMS:
            raise ValueError(f"exact_sums takes fewer than 2^30 terms on a rank, got {block.shape[0]}")
        _accumulate(np.ascontiguousarray(block, dtype=np.float64).view(np.int64), limbs, first)
        first += block.shape[1]
    _carry(limbs)
    if comm is not None and comm.size > 1:
        total = np.empty_like(limbs)
        comm.Allreduce(limbs, total)  # MPI.SUM; carried limbs leave room for 2^31 ranks
        limbs = total
        _carry(limbs)
    return np.array([_rounded(row) for row in limbs])


def _rounded(row: np.ndarray) -> float:
    """The float64 nearest to one carried superaccumulator (LIMBS limbs and the count of non-finite terms)."""
    if row[LIMBS]:
        return float("nan")
    integer = int.from_bytes((row[:LIMBS] & 0xFFFFFFFF).astype("<u4").tobytes(), "little", signed=True)
    try:
        return integer / _UNIT  # int / int is correctly rounded, also below the normal range
    except OverflowError:
        return float("inf") if integer > 0 else float("-inf")
