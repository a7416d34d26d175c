"""Which temperature tensors a velocity grid can hold, and the nearest to one that it cannot.

Along an axis with nodes x_j <= u <= x_{j+1} around the mean no positive grid function has less variance than
(u - x_j)(x_{j+1} - u). Where that forbids a tensor, the variance of that axis is raised to what can be held and
the other axes give the difference, which keeps rho, u and T.
"""

from __future__ import annotations

from rvm_mpi.compiling.declare import part

#: room in h^2 that a variance must have above the least, for Newton's method to find the Gaussian
ROOM = 0.01
#: the tensor was met; it was replaced by the nearest one; not even T can be held
EXACT, REPLACED, TOO_COLD = 0, 1, 2


@part
def smallest_variance(nodes, count, mean):  # type: ignore[no-untyped-def]
    """The least variance a positive function on these nodes can have with this mean; negative outside the nodes."""
    if count == 1:
        return 0.0
    h = nodes[1] - nodes[0]
    j = int((mean - nodes[0]) / h)
    j = min(max(j, 0), count - 2)
    return (mean - nodes[j]) * (nodes[j + 1] - mean)


@part
def realisable_tensor(mean, tensor, grid):  # type: ignore[no-untyped-def]
    """Bring a temperature tensor within what the grid can hold, in place, keeping its trace.

    `tensor` is (xx, xy, xz, yy, yz, zz). Returns EXACT, REPLACED, or TOO_COLD where not even the trace can be held.
    """
    dimensions, points, nodes = grid.dimensions, grid.points, grid.nodes
    diagonal = (0, 3, 5)
    short, slack = 0.0, 0.0
    for i in range(dimensions):
        h = nodes[i, 1] - nodes[i, 0] if points[i] > 1 else 1.0
        if not abs(mean[i]) < nodes[i, points[i] - 1]:
            return TOO_COLD
        floor = smallest_variance(nodes[i], points[i], mean[i]) + ROOM * h * h
        room = tensor[diagonal[i]] - floor
        if room < 0.0:
            short -= room
        else:
            slack += room
    if short == 0.0:
        return EXACT
    if slack <= short:
        return TOO_COLD
    keep = 1.0 - short / slack
    shrink = (1.0, 1.0, 1.0)
    for i in range(dimensions):
        h = nodes[i, 1] - nodes[i, 0] if points[i] > 1 else 1.0
        floor = smallest_variance(nodes[i], points[i], mean[i]) + ROOM * h * h
        room = tensor[diagonal[i]] - floor
        if room < 0.0:
            tensor[diagonal[i]] = floor
            shrink = (
                0.0 if i == 0 else shrink[0],
                0.0 if i == 1 else shrink[1],
                0.0 if i == 2 else shrink[2],
            )
        else:
            tensor[diagonal[i]] = floor + keep * room
    # no correlation with an axis at its least variance; what the others lose they lose in proportion
    tensor[1] *= shrink[0] * shrink[1] * keep
    tensor[2] *= shrink[0] * shrink[2] * keep
    tensor[4] *= shrink[1] * shrink[2] * keep
    return REPLACED


@part
def determinant(t, dimensions):  # type: ignore[no-untyped-def]
    """Determinant of the first `dimensions` axes of a tensor (xx, xy, xz, yy, yz, zz)."""
    if dimensions == 1:
        return t[0]
    if dimensions == 2:
        return t[0] * t[3] - t[1] * t[1]
    xx, xy, xz, yy, yz, zz = t[0], t[1], t[2], t[3], t[4], t[5]
    return xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)


@part
def invert_tensor(t, dimensions, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a tensor (xx, xy, xz, yy, yz, zz) in its first `dimensions` axes, else 0; False if not positive."""
    det = determinant(t, dimensions)
    if not (t[0] > 0.0 and determinant(t, min(dimensions, 2)) > 0.0 and det > 0.0):
        return False
    xx, xy, xz, yy, yz, zz = t[0], t[1], t[2], t[3], t[4], t[5]
    for i in range(6):
        inverse[i] = 0.0
    if dimensions == 1:
        inverse[0] = 1.0 / xx
    elif dimensions == 2:
        inverse[0], inverse[1], inverse[3] = yy / det, -xy / det, xx / det
    else:
        inverse[0] = (yy * zz - yz * yz) / det
        inverse[1] = (xz * yz - xy * zz) / det
        inverse[2] = (xy * yz - xz * yy) / det
        inverse[3] = (xx * zz - xz * xz) / det
        inverse[4] = (xy * xz - xx * yz) / det
        inverse[5] = (xx * yy - xy * xy) / det
    return True
