"""Boundary conditions of g: what the two ghost cells beyond a side hold.

Velocities that leave see the extrapolated gas, cut at zero, so that the limiter keeps second order up to the wall;
velocities that enter see, in both ghost cells, the value g has on the face: reflected, of the wall's or of the far
gas's Maxwellian, or none. Wall and far states are written in the inner cell's omega: u/omega and T/omega^2. A specular
wall mirrors the gas, which is the same as the mirrored domain beyond it.
"""

from __future__ import annotations

import math

from rvm_mpi.kernels import kernel, part

SPECULAR, MAXWELL, FAR_FIELD, OUTFLOW, VACUUM = range(5)
KINDS = {
    "specular": SPECULAR,
    "maxwell": MAXWELL,
    "far-field": FAR_FIELD,
    "outflow": OUTFLOW,
    "vacuum": VACUUM,
}


@part
def inward_flux(density, normal, temperature):  # type: ignore[no-untyped-def]
    """Mass per area and time that a half-space of Maxwellian gas sends in; `normal` is its inward velocity."""
    s = normal / math.sqrt(2.0 * temperature)
    return density * (math.sqrt(temperature / (2.0 * math.pi)) * math.exp(-s * s) + 0.5 * normal * (1.0 + math.erf(s)))


@part
def outgoing_face(g, inner, inward, at):  # type: ignore[no-untyped-def]
    """g on the face for a velocity that leaves: the limited slope towards the extrapolation, cut at zero."""
    here, before = g[inner + at], g[inner + inward + at]
    a, b = here - before, max(2.0 * here - before, 0.0) - here
    return here + (a * b / (a + b) if a * b > 0.0 else 0.0)


@kernel
def fill_side(g, inner, along, inward, count, axis, sign, kind, accommodation, states, omega, grid, work):  # type: ignore[no-untyped-def]
    """Fill the ghost cells beyond one side of a rank.

    Parameters
    ----------
    g : flat array of blocks
    inner, along, inward : int
        Offset of the side's first inner cell, step to the next cell along the side, and step to the next cell inward.
    count : int
        Cells along the side.
    axis, sign : int
        Normal direction (0 x, 1 y); +1 where xi_n > 0 enters (a lower side), else -1.
    kind, accommodation : int, float
        Which condition, and the fraction thermalised of a Maxwell wall.
    states : (count, 5) array
        rho, u_x, u_y, u_z, T of the wall or the far gas.
    omega : (count,) array
        Scaling of the inner cells.
    grid : stage.Grid
    work : (4, longest axis) array
        Work space, three wide at least.
    """
    nvx, nvy, nvz = grid.points
    size = grid.slab_size
    factor, peak = work[:3], work[3]
    for c in range(count):
        cell = inner + c * along
        near, far = cell - inward, cell - 2 * inward
        if kind == SPECULAR:
            for k in range(nvx):
                for j in range(nvy):
                    mirrored = ((nvx - 1 - k) * size + j * nvz) if axis == 0 else (k * size + (nvy - 1 - j) * nvz)
                    at = k * size + j * nvz
                    for n in range(nvz):
                        g[near + at + n] = g[cell + mirrored + n]
                        g[far + at + n] = g[cell + inward + mirrored + n]
            continue
        scale = 0.0
        if kind == MAXWELL or kind == FAR_FIELD:
            w = omega[c]
            variance = states[c, 4] / (w * w)
            for q in range(3):
                highest = -math.inf
                mean = states[c, 1 + q] / w
                for n in range(grid.points[q]):
                    s = grid.nodes[q, n] - mean
                    factor[q, n] = -0.5 * s * s / variance
                    if q != axis or sign * grid.nodes[q, n] > 0.0:
                        highest = max(highest, factor[q, n])
                peak[q] = highest
                for n in range(grid.points[q]):
                    factor[q, n] = math.exp(min(factor[q, n] - highest, 0.0))
            arriving, leaving = 0.0, 0.0
            for k in range(nvx):
                for j in range(nvy):
                    speed = sign * (grid.nodes[0, k] if axis == 0 else grid.nodes[1, j])
                    for n in range(nvz):
                        at = k * size + j * nvz + n
                        if speed > 0.0:
                            arriving += speed * factor[0, k] * factor[1, j] * factor[2, n]
                        elif kind == MAXWELL:
                            leaving -= speed * outgoing_face(g, cell, inward, at)
            if kind == MAXWELL:
                scale = accommodation * leaving / arriving
            else:
                flux = inward_flux(states[c, 0], sign * states[c, 1 + axis], states[c, 4])
                scale = flux / (w * grid.weight * arriving)
                # where the grid resolves the gas, the density of the whole Maxwellian instead: the sum over half the
                # nodes is off by h^2/24, which a uniform gas must not see
                per_spacing = grid.per_spacing[axis]
                resolved = min(max(4.0 * variance * per_spacing * per_spacing - 1.0, 0.0), 1.0)
                if resolved > 0.0:
                    whole = 1.0
                    for q in range(3):
                        mean, part = states[c, 1 + q] / w, 0.0
                        for n in range(grid.points[q]):
                            s = grid.nodes[q, n] - mean
                            part += math.exp(-0.5 * s * s / variance - peak[q])
                        whole *= part
                    scale += resolved * (states[c, 0] / (grid.weight * whole) - scale)
        for k in range(nvx):
            for j in range(nvy):
                speed = sign * (grid.nodes[0, k] if axis == 0 else grid.nodes[1, j])
                mirrored = ((nvx - 1 - k) * size + j * nvz) if axis == 0 else (k * size + (nvy - 1 - j) * nvz)
                for n in range(nvz):
                    at = k * size + j * nvz + n
                    if kind == OUTFLOW:
                        value = g[cell + at]
                    elif speed > 0.0:
                        value = 0.0
                        if kind != VACUUM:
                            value = scale * factor[0, k] * factor[1, j] * factor[2, n]
                        if kind == MAXWELL and accommodation < 1.0:
                            value += (1.0 - accommodation) * outgoing_face(g, cell, inward, mirrored + n)
                    else:
                        value = max(2.0 * g[cell + at] - g[cell + inward + at], 0.0)
                    g[near + at] = value
                    g[far + at] = value
