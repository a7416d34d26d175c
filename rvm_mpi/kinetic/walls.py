"""Boundary conditions of g: what the two ghost cells beyond a side hold, and what their nodes cannot say.

Velocities that leave see the extrapolated gas, half of that inside at least: the face's value is of second order up to
the wall, and something always leaves. Velocities that enter see in the near ghost cell the value g has on the face,
reflected, of the wall's or of the far gas's Maxwellian, or none, and in the far one what makes the face's value the
near cell's. A specular wall mirrors the gas, which is the same as the mirrored domain beyond it.

A Maxwellian that enters is the discrete Gaussian that the gas inside relaxes to (`gaussian.fit_axis`, axis by axis), in
the inner cell's omega: u/omega and T/omega^2. So a gas in equilibrium with its side stays as it is, to round-off, on
any grid. Where the nodes of the inner cell cannot hold the side's temperature or velocity (a wall much colder than the
gas), they take the nearest that they can; mass, momentum and energy that cross the face are those of the side's state
all the same, and the difference goes to the carried moments alone: the columns of `beyond`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from rvm_mpi.compiling.declare import kernel, part
from rvm_mpi.kinetic.gaussian import fit_axis
from rvm_mpi.kinetic.limiter import ROOM as FACE_ROOM
from rvm_mpi.kinetic.limiter import face_number
from rvm_mpi.kinetic.realisable import ROOM, smallest_variance

SPECULAR, MAXWELL, FAR_FIELD, OUTFLOW, VACUUM = range(5)
KINDS = {
    "specular": SPECULAR,
    "maxwell": MAXWELL,
    "far-field": FAR_FIELD,
    "outflow": OUTFLOW,
    "vacuum": VACUUM,
}
#: a variance of so many h^2 is resolved: its half-space has the mass flux of a Maxwellian within 4 %
RESOLVED = 1.0
#: no grid point holds less than h^2/4 wherever the mean is; a little more, for Newton's method
HELD_ANYWHERE = 0.27
#: a box of so many thermal speeds on either side holds a Gaussian nearly as it is
REACH = 3.5
#: variances that differ by less than this are the same
ROUNDED = 1e-9


class Side(NamedTuple):
    """One side of a rank for `fill_side`.

    inner, along, inward: offset in g of the side's first inner cell, step to the next cell along the side, and step to
    the next cell inward. axis, sign: normal direction (0 x, 1 y); +1 where xi_n > 0 enters (a lower side), else -1.
    kind, accommodation: which condition, and the fraction thermalised of a Maxwell wall. rate: 1 over the width of
    a cell along the normal where moments are carried, else 0.
    """

    inner: int
    along: int
    inward: int
    axis: int
    sign: int
    kind: int
    accommodation: float
    rate: float


@part
def extrapolated(here, before):  # type: ignore[no-untyped-def]
    """g beyond a side from the two cells inside; half of the inner one's at least, so that something always leaves."""
    return max(2.0 * here - before, 0.5 * here)


@part
def outgoing_face(g, inner, inward, at):  # type: ignore[no-untyped-def]
    """g on the face for a velocity that leaves, which sees the extrapolation beyond."""
    here, before = g[inner + at], g[inner + inward + at]
    return face_number(here, here - before, extrapolated(here, before) - here, FACE_ROOM)


@part
def axis_gaussian(nodes, count, mean, variance, fit, factor):  # type: ignore[no-untyped-def]
    """factor = the discrete Gaussian of one axis with this mean and variance; its sum is one."""
    if count == 1:
        factor[0] = 1.0
        return
    fit_axis(nodes, count, mean, variance, fit)
    whole = 0.0
    for n in range(count):
        s = nodes[n] - mean
        factor[n] = math.exp(min(s * (fit[0] * s + fit[1]), 600.0))
        whole += factor[n]
    for n in range(count):
        factor[n] /= whole


@part
def nearest_held(nodes, count, mean, variance, own):  # type: ignore[no-untyped-def]
    """The mean and variance nearest to those given that an axis can hold; `own`, the gas's own T_g, counts as held."""
    if count == 1:
        return 0.0, 0.0
    h, edge = nodes[1] - nodes[0], nodes[count - 1]
    centre = min(max(mean, 0.25 * h - edge), edge - 0.25 * h)
    widest = max(own, ((edge + 0.5 * h) / REACH) ** 2)
    return centre, max(min(variance, widest), smallest_variance(nodes, count, centre) + ROOM * h * h)


@part
def frame(nodes, count, mean, variance, own, own_frame):  # type: ignore[no-untyped-def]
    """The factor on omega of a frame in which the normal axis holds a side's state; 1 where it does as it is.

    Parameters
    ----------
    mean, variance : float
        The side's, in the inner cell's omega.
    own : float
        T_g of the inner cell. A state at the gas's own temperature, or one that is resolved, is held.
    own_frame : float
        The side's own omega over the inner cell's, for a state too fast for a smaller one.
    """
    h, edge = nodes[1] - nodes[0], nodes[count - 1]
    least, widest = min(own, RESOLVED * h * h), max(own, ((edge + 0.5 * h) / REACH) ** 2)
    held = abs(mean) < edge and variance >= smallest_variance(nodes, count, mean) + ROOM * (1.0 - ROUNDED) * h * h
    if held and least * (1.0 - ROUNDED) <= variance <= widest * (1.0 + ROUNDED):
        return 1.0
    scale = math.sqrt(variance / (widest if variance > widest else max(least, HELD_ANYWHERE * h * h)))
    return scale if abs(mean) < 0.5 * edge * scale else max(scale, own_frame)


@part
def half_space(nodes, count, sign, factor):  # type: ignore[no-untyped-def]
    """Sums of c, c^2, c^3 times factor over the nodes that enter, c their inward speed."""
    first, second, third = 0.0, 0.0, 0.0
    for n in range(count):
        c = sign * nodes[n]
        if c > 0.0:
            first += c * factor[n]
            second += c * c * factor[n]
            third += c * c * c * factor[n]
    return first, second, third


@part
def entering(side, state, omega, sums, grid, work, lack):  # type: ignore[no-untyped-def]
    """The Maxwellian that a side sends in, as one factor for each axis: `work[:3]`, each with sum one.

    Parameters
    ----------
    state : (5,) array
        rho, u, T of the wall or the far gas.
    omega, sums : float, (10,) array
        Of the inner cell.
    work : (5, longest axis) array
        Three factors, work space for a fourth, and for the fit.
    lack : (5,) array
        Receives momentum and energy that the side's state carries through the face, per mass, beyond what the factors
        do: normal component along the inner normal; nothing but round-off where the nodes hold the state.

    Returns
    -------
    float
        Density over node weight of the factors' product for which they have the mass flux of a gas of density rho.
    """
    own = (sums[4] + sums[7] + sums[9]) / sums[0]
    for q in range(3):
        own -= (sums[1 + q] / sums[0]) ** 2
    own /= grid.dimensions
    variance = state[4] / (omega * omega)
    fit = work[4]
    energy, speed2 = 0.0, 0.0
    for q in range(grid.dimensions):
        mean = state[1 + q] / omega
        speed2 += mean * mean
        nodes, count = grid.nodes[q], grid.points[q]
        centre, width = nearest_held(nodes, count, mean, variance, own)
        axis_gaussian(nodes, count, centre, width, fit, work[q])
        if q != side.axis:
            first, second = 0.0, 0.0
            for n in range(count):
                first += nodes[n] * work[q, n]
                second += nodes[n] * nodes[n] * work[q, n]
            lack[1 + q] = omega * (mean - first)
            energy += mean * mean + variance - second
    for q in range(grid.dimensions, 3):
        work[q, 0], lack[1 + q] = 1.0, 0.0
    nodes, count, mean = grid.nodes[side.axis], grid.points[side.axis], state[1 + side.axis] / omega
    scale = frame(nodes, count, mean, variance, own, math.sqrt(variance + speed2 / grid.dimensions))
    first, second, third = half_space(nodes, count, side.sign, work[side.axis])
    c1, c2, c3 = first, second, third
    if scale != 1.0:
        axis_gaussian(nodes, count, mean / scale, variance / (scale * scale), fit, work[3])
        c1, c2, c3 = half_space(nodes, count, side.sign, work[3])
    lack[0], lack[1 + side.axis], lack[4] = 0.0, 0.0, 0.0
    if not (first > 0.0 and c1 > 0.0):  # all of the gas flows out
        for q in range(5):
            lack[q] = 0.0
        return 0.0
    lack[1 + side.axis] = omega * (scale * (c2 / c1) - second / first)
    energy += scale * scale * (c3 / c1) - third / first
    lack[4] = 0.5 * omega * omega * energy
    return state[0] / grid.weight * (scale * c1 / first)


@part
def inward_speed(side, grid, k, j):  # type: ignore[no-untyped-def]
    """Of the nodes (k, j, ...): xi_n along the inner normal."""
    return side.sign * (grid.nodes[0, k] if side.axis == 0 else grid.nodes[1, j])


@part
def mirrored(side, grid, k, j):  # type: ignore[no-untyped-def]
    """Place in a block of the first of the nodes that the side mirrors (k, j, ...) to."""
    if side.axis == 0:
        return (grid.points[0] - 1 - k) * grid.slab_size + j * grid.points[2]
    return k * grid.slab_size + (grid.points[1] - 1 - j) * grid.points[2]


@part
def specular(g, cell, side, grid):  # type: ignore[no-untyped-def]
    """Ghost cells of a wall that mirrors: the gas that a mirrored domain beyond it would hold."""
    near = cell - side.inward
    for k in range(grid.points[0]):
        for j in range(grid.points[1]):
            at, there = k * grid.slab_size + j * grid.points[2], mirrored(side, grid, k, j)
            for n in range(grid.points[2]):
                g[near + at + n] = g[cell + there + n]
                g[near - side.inward + at + n] = g[cell + side.inward + there + n]


@part
def outflow(g, cell, side, grid):  # type: ignore[no-untyped-def]
    """Ghost cells of an open side: the inner cell's gas, whichever way it flies."""
    near = cell - side.inward
    for k in range(grid.points[0]):
        for at in range(k * grid.slab_size, k * grid.slab_size + grid.points[1] * grid.points[2]):
            g[near + at] = g[cell + at]
            g[near - side.inward + at] = g[cell + at]


@part
def vacuum(g, cell, side, grid):  # type: ignore[no-untyped-def]
    """Ghost cells of a side that sends nothing in; what leaves is extrapolated."""
    near = cell - side.inward
    for k in range(grid.points[0]):
        for j in range(grid.points[1]):
            enters = inward_speed(side, grid, k, j) > 0.0
            first = k * grid.slab_size + j * grid.points[2]
            for at in range(first, first + grid.points[2]):
                value = 0.0 if enters else extrapolated(g[cell + at], g[cell + side.inward + at])
                g[near + at] = value
                # where it enters the differences are as 1 to -2, for which the face's value is the near cell's
                g[near - side.inward + at] = 2.0 * g[cell + at] - value


@part
def far_field(g, cell, side, grid, density, work):  # type: ignore[no-untyped-def]
    """Ghost cells of a side that sends in the Maxwellian `density` times the factors in `work` (`entering`)."""
    vacuum(g, cell, side, grid)
    near = cell - side.inward
    for k in range(grid.points[0]):
        for j in range(grid.points[1]):
            if inward_speed(side, grid, k, j) > 0.0:
                first = k * grid.slab_size + j * grid.points[2]
                for n in range(grid.points[2]):
                    value = density * work[0, k] * work[1, j] * work[2, n]
                    g[near + first + n] = value
                    g[near - side.inward + first + n] = 2.0 * g[cell + first + n] - value


@part
def maxwell(g, cell, side, grid, density, work):  # type: ignore[no-untyped-def]
    """Ghost cells of a wall that sends in a Maxwellian and, of what arrives, the share that it mirrors."""
    far_field(g, cell, side, grid, density, work)
    near, share = cell - side.inward, 1.0 - side.accommodation
    if share == 0.0:
        return
    for k in range(grid.points[0]):
        for j in range(grid.points[1]):
            if inward_speed(side, grid, k, j) > 0.0:
                at, there = near + k * grid.slab_size + j * grid.points[2], mirrored(side, grid, k, j)
                for n in range(grid.points[2]):
                    value = share * outgoing_face(g, cell, side.inward, there + n)
                    g[at + n] += value
                    g[at - side.inward + n] -= value


@part
def flux_in(side, grid, work):  # type: ignore[no-untyped-def]
    """Sum over the nodes that enter of their inward speed times the factors in `work`."""
    flux = 0.0
    for k in range(grid.points[0]):
        for j in range(grid.points[1]):
            speed = inward_speed(side, grid, k, j)
            if speed > 0.0:
                for n in range(grid.points[2]):
                    flux += speed * work[0, k] * work[1, j] * work[2, n]
    return flux


@part
def flux_out(g, cell, side, grid):  # type: ignore[no-untyped-def]
    """Sum over the nodes that leave of their outward speed times g on the face."""
    flux = 0.0
    for k in range(grid.points[0]):
        for j in range(grid.points[1]):
            speed = inward_speed(side, grid, k, j)
            if not speed > 0.0:
                at = k * grid.slab_size + j * grid.points[2]
                for n in range(grid.points[2]):
                    flux -= speed * outgoing_face(g, cell, side.inward, at + n)
    return flux


@kernel
def fill_side(g, side, states, omega, sums, grid, work, beyond):  # type: ignore[no-untyped-def]
    """Fill the ghost cells beyond one side of a rank.

    Parameters
    ----------
    g : flat array of blocks
    side : Side
    states : (count, 5) array
        rho, u_x, u_y, u_z, T of the wall or the far gas, for each cell along the side.
    omega, sums : (count,) array, (count, 10) array
        Scaling of the inner cells, and their sums of 1, xi, xi xi (`data.Cells`).
    grid : data.Grid
    work : (6, longest axis in whole vectors) array
        Work space.
    beyond : (count, 5) array
        Receives rates of mass (none), momentum and energy through the faces, counted along the axis, that the side's
        state has beyond what the nodes of its ghost cells have.
    """
    beyond[:] = 0.0
    lack = work[5]
    for c in range(omega.size):
        cell = side.inner + c * side.along
        if side.kind == SPECULAR:
            specular(g, cell, side, grid)
        elif side.kind == OUTFLOW:
            outflow(g, cell, side, grid)
        elif side.kind == VACUUM:
            vacuum(g, cell, side, grid)
        else:
            density = entering(side, states[c], omega[c], sums[c], grid, work, lack)
            arriving = flux_in(side, grid, work)
            if side.kind == MAXWELL:
                density = side.accommodation * flux_out(g, cell, side, grid) / arriving
                maxwell(g, cell, side, grid, density, work)
            else:
                far_field(g, cell, side, grid, density, work)
            mass = side.rate * grid.weight * omega[c] * density * arriving
            for q in range(1, 5):
                # inward momentum along the normal counts the same whichever way the axis points
                beyond[c, q] = mass * lack[q] * (1.0 if q == 1 + side.axis else side.sign)
