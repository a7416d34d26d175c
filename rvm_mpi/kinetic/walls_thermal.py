"""Boundary conditions of g in the thermal scaling: what the two ghost cells beyond a side hold, and their frames.

A mirror's ghost cells are the mirrored gas in the mirrored frame, as inside. At any other side the near cell
extrapolates the gas inside, which is all that what leaves sees of it; the far cell holds g on the face of what enters,
in the frame of the near cell. That frame is the inner cell's, for a wall mirrored, so that the gas inside and what
enters need no turning into each other; it is the side's own where the inner one's nodes cannot hold the side's state.
"""

from __future__ import annotations

import math

from rvm_mpi.compiling.declare import kernel, part
from rvm_mpi.kinetic.walls import (
    FAR_FIELD,
    MAXWELL,
    OUTFLOW,
    REACH,
    SPECULAR,
    axis_gaussian,
    extrapolated,
    mirrored,
    outgoing_face,
)

#: least variance of a side's state in the inner cell's frame, and the largest distance of its mean in thermal speeds
COLDEST, FARTHEST = 0.3, 2.0
#: what nodes hold wherever the mean is, over h^2
HELD = 0.27


@part
def side_frame(side, state, inner, omega, grid, frame):  # type: ignore[no-untyped-def]
    """The frame (u, omega) of what enters: the inner cell's, for a wall mirrored, or the side's own."""
    sign = -1.0 if side.kind == MAXWELL or side.kind == SPECULAR else 1.0
    for q in range(3):
        frame[q] = inner[q] * (sign if q == side.axis else 1.0)
    frame[3] = omega
    if not (side.kind == MAXWELL or side.kind == FAR_FIELD):
        return
    variance, distance, least, edge = state[4] / (omega * omega), 0.0, COLDEST, grid.half_width[0] / REACH
    for q in range(grid.dimensions):
        distance += (state[1 + q] - frame[q]) ** 2
        least = max(least, HELD / grid.per_spacing[q] ** 2)
        edge = min(edge, grid.half_width[q] / REACH)
    own = side.kind == FAR_FIELD or side.accommodation == 1.0
    if own and (variance < least or variance > edge * edge or math.sqrt(distance) > FARTHEST * omega):
        for q in range(3):
            frame[q] = state[1 + q]
        frame[3] = math.sqrt(state[4])


@part
def maxwellian_in(frame, state, grid, work):  # type: ignore[no-untyped-def]
    """A side's Maxwellian on the nodes of a frame, as one factor for each axis with sum one: `work[:3]`."""
    for q in range(3):
        if q < grid.dimensions:
            mean, variance = (state[1 + q] - frame[q]) / frame[3], state[4] / (frame[3] * frame[3])
            axis_gaussian(grid.nodes[q], grid.points[q], mean, variance, work[4], work[q])
        else:
            work[q, 0] = 1.0


@part
def inward(side, frame, grid, k, j):  # type: ignore[no-untyped-def]
    """Of the nodes (k, j, ...) in a frame: v_n along the inner normal."""
    xi = grid.nodes[0, k] if side.axis == 0 else grid.nodes[1, j]
    return side.sign * (frame[side.axis] + frame[3] * xi)


@part
def arriving(g, cell, side, inner, grid):  # type: ignore[no-untyped-def]
    """Sum over the nodes that leave of their outward speed times g on the face."""
    flux = 0.0
    for k in range(grid.points[0]):
        for j in range(grid.points[1]):
            speed = inward(side, inner, grid, k, j)
            if speed < 0.0:
                at = k * grid.slab_size + j * grid.points[2]
                for n in range(grid.points[2]):
                    flux -= speed * outgoing_face(g, cell, side.inward, at + n)
    return flux


@part
def entering(side, frame, grid, work):  # type: ignore[no-untyped-def]
    """Sum over the nodes that enter of their inward speed times the factors in `work`."""
    flux = 0.0
    for k in range(grid.points[0]):
        for j in range(grid.points[1]):
            speed = inward(side, frame, grid, k, j)
            if speed > 0.0:
                for n in range(grid.points[2]):
                    flux += speed * work[0, k] * work[1, j] * work[2, n]
    return flux


@kernel
def fill_moving_side(g, side, states, inner, frames, grid, work):  # type: ignore[no-untyped-def]
    """Fill the ghost cells beyond one side of a rank, and find their frames.

    Parameters
    ----------
    g : flat array of blocks
    side : walls.Side
    states : (count, 5) array
        rho, u_x, u_y, u_z, T of the wall or the far gas, for each cell along the side.
    inner, frames : (count, 4) arrays
        Frames u, omega of the inner cells; receives those of the ghost cells.
    grid : data.Grid
    work : (6, longest axis in whole vectors) array
        Work space.
    """
    nz = grid.points[2]
    for c in range(states.shape[0]):
        cell = side.inner + c * side.along
        near = cell - side.inward
        far = near - side.inward
        frame = frames[c]
        side_frame(side, states[c], inner[c], inner[c, 3], grid, frame)
        density, share = 0.0, 0.0
        if side.kind == FAR_FIELD or side.kind == MAXWELL:
            maxwellian_in(frame, states[c], grid, work)
            density = states[c, 0] / grid.weight
        if side.kind == MAXWELL:
            share = 1.0 - side.accommodation
            density = side.accommodation * arriving(g, cell, side, inner[c], grid) / entering(side, frame, grid, work)
        for k in range(grid.points[0]):
            for j in range(grid.points[1]):
                at = k * grid.slab_size + j * nz
                there = mirrored(side, grid, k, j)
                for n in range(nz):
                    if side.kind == SPECULAR:
                        g[near + at + n] = g[cell + there + n]
                        g[far + at + n] = g[cell + side.inward + there + n]
                        continue
                    here = g[cell + at + n]
                    g[near + at + n] = extrapolated(here, g[cell + side.inward + at + n])
                    value = here if side.kind == OUTFLOW else density * work[0, k] * work[1, j] * work[2, n]
                    if share > 0.0:
                        value += share * outgoing_face(g, cell, side.inward, there + n)
                    g[far + at + n] = value
