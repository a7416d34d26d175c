"""How fast the drift a(xi) = -(A + xi_x . grad omega) xi + beta u moves g over a cell's velocity grid."""

from __future__ import annotations

from rvm_mpi.compiling.declare import part
from rvm_mpi.grid.velocity import TAPS


@part
def guard_of(points_z):  # type: ignore[no-untyped-def]
    """Zeros before and after a row of work space: what the widest stencil reaches in y."""
    return (TAPS // 2) * points_z + 8


@part
def fastest_turning(drift, half_width):  # type: ignore[no-untyped-def]
    """The largest |A + xi . grad omega| in the box."""
    turning = abs(drift.own) + max(abs(drift.rising_x), abs(drift.falling_x)) * half_width[0]
    return turning + max(abs(drift.rising_y), abs(drift.falling_y)) * half_width[1]


@part
def fastest_along(grid, drift, turning, q):  # type: ignore[no-untyped-def]
    """max|a|/h along direction q of velocity, zero for one not in use; `turning` as `fastest_turning` says."""
    if q >= grid.dimensions:
        return 0.0
    return (turning * grid.half_width[q] + abs(drift.push[q])) * grid.per_spacing[q]
