"""How fast the drift a(xi) = -(A + xi_x . grad omega) xi + beta u moves g over a cell's velocity grid."""

from __future__ import annotations

from rvm_mpi.compiling.declare import part
from rvm_mpi.grid.velocity import TAPS


@part
def guard_of(points_z):  # type: ignore[no-untyped-def]
    """Zeros before and after a row of work space: what the widest stencil reaches in y."""
    return (TAPS // 2) * points_z + 8


@part
def fastest_turning(own, rises, half_width):  # type: ignore[no-untyped-def]
    """The largest |A + xi . grad omega| in the box; rises: d omega/dx as what goes up and down sees it, d omega/dy."""
    turning = abs(own) + max(abs(rises[0]), abs(rises[1])) * half_width[0]
    return turning + max(abs(rises[2]), abs(rises[3])) * half_width[1]


@part
def fastest_along(grid, push, turning, q):  # type: ignore[no-untyped-def]
    """max|a|/h along direction q of velocity, zero for one not in use; `turning` as `fastest_turning` says."""
    if q >= grid.dimensions:
        return 0.0
    return (turning * grid.half_width[q] + abs(push)) * grid.per_spacing[q]


@part
def reached(flow, half_width, up, down):  # type: ignore[no-untyped-def]
    """Least and most of (xi + flow) times `up` where xi + flow > 0, `down` where it is not, over the box."""
    first, last = flow - half_width, flow + half_width
    at_first = first * (up if first > 0.0 else down)
    at_last = last * (up if last > 0.0 else down)
    low, high = min(at_first, at_last), max(at_first, at_last)
    if first < 0.0 < last:
        low, high = min(low, 0.0), max(high, 0.0)
    return low, high


@part
def fastest_thermal(grid, own, rises, push, flow, shears):  # type: ignore[no-untyped-def]
    """max|a|/h along each axis, velocities counted from the gas's mean: bounds by what each term reaches in the box.

    The gas's own flow cancels in them, so that they do not depend on its Mach number.
    """
    half_width = grid.half_width
    low_x, high_x = reached(flow[0], half_width[0], rises[0], rises[1])
    low_y, high_y = reached(flow[1], half_width[1], rises[2], rises[3])
    turning = max(abs(own + low_x + low_y), abs(own + high_x + high_y))
    up_x, down_x, up_y, down_y = shears
    low_x, high_x = reached(flow[0], half_width[0], up_x[0], down_x[0])
    low_y, high_y = reached(flow[1], half_width[1], up_y[0], down_y[0])
    x = max(abs(push[0] - low_x - low_y), abs(push[0] - high_x - high_y))
    low_x, high_x = reached(flow[0], half_width[0], up_x[1], down_x[1])
    low_y, high_y = reached(flow[1], half_width[1], up_y[1], down_y[1])
    y = max(abs(push[1] - low_x - low_y), abs(push[1] - high_x - high_y))
    low_x, high_x = reached(flow[0], half_width[0], up_x[2], down_x[2])
    low_y, high_y = reached(flow[1], half_width[1], up_y[2], down_y[2])
    z = max(abs(push[2] - low_x - low_y), abs(push[2] - high_x - high_y))
    return (
        fastest_along(grid, x, turning, 0),
        fastest_along(grid, y, turning, 1),
        fastest_along(grid, z, turning, 2),
    )
