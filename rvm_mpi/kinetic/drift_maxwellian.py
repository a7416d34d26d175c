"""The drift's fluxes from g relative to the cell's own Maxwellian: positive, and accurate on few velocities.

What is reconstructed is not g, whose flank looks like a shock on a coarse grid, but h = g/M with the Maxwellian M of
the cell's mean and temperature: a constant where the gas is in equilibrium. Along each axis, with a on a face F of the
grid and k the node that it comes from:

1. v on the face by the parabola through h_k and its two neighbours, bounded (`limiter.towards_face`);
2. P = a M_F v, the product there to second order, exact where h is constant;
3. the flux P - (P_+ - 2 P + P_-)/24: its difference over h is then a derivative of fourth order at the node; a
   neighbour's P counts no more than STEEPEST times the others;
4. none beyond the share of what its donor has that this face may carry in the step: so g stays positive whatever it is.

That fluxes may go against P's sign matters where a changes its own: without them a temperature gradient gives the gas a
momentum, whose correction takes one per cent of the heat flux.
"""

from __future__ import annotations

import math

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import (
    exponential,
    fma,
    load,
    maximum,
    minimum,
    prefetch,
    splat,
    store,
    where_above,
    where_negative,
    where_positive,
)
from rvm_mpi.grid.velocity import Y_BEND, Y_FACE, Y_FIRST, Y_LAST, Y_OPEN, Z_BEND, Z_FACE, Z_OPEN, Y, Z
from rvm_mpi.kinetic.drift_speed import guard_of
from rvm_mpi.kinetic.limiter import towards_face

#: rows of a slab that the work space holds
ROWS = 20
#: numbers for each node along x
FACTORS = 4
#: of what a node has, the part that all its faces together may take away
SHARE = 0.999
#: of that, the part that a face has for each of the two faces of the node through which P goes the way it goes there
TURNED = 0.375
#: how many times the larger of P on a face and P on its other neighbour a neighbour's P counts at most: from there on
#: the flux would turn against P, far out where P grows so from face to face, and rounding grow, a millionfold in 12
#: steps of a disc
STEEPEST = 26.0
#: exponents of 1/M stay below this, far inside the range of doubles
HIGHEST = 600.0
#: the exponent of what there is not
NONE = -1e300


@part
def width_of(drift, half_width, dimensions):  # type: ignore[no-untyped-def]
    """The Maxwellian's temperature: the cell's, or one so much wider that no exponent passes `HIGHEST`."""
    farthest = 0.0
    for q in range(dimensions):
        farthest += (half_width[q] + abs(drift.centre[q])) ** 2
    return max(drift.temperature, farthest / (2.0 * HIGHEST))


@part
def sampled(per_spacing, sign, mean, temperature):  # type: ignore[no-untyped-def]
    """The Gaussian whose samples on a uniform grid have this mean and variance: centre, -1/(2 width), sum of samples.

    By the first harmonic of Poisson's sum: for a spacing of 1.75 thermal speeds the width differs by 4 % from the
    temperature, for one below 1 by nothing. sign: 1 for a grid with a sample at zero, -1 for one with zero in between.
    """
    centre, width, share = mean, temperature, 0.0
    wave = 2.0 * math.pi * per_spacing
    for _ in range(3):
        share = sign * math.exp(-0.5 * wave * wave * width)
        phase = wave * centre
        centre = mean + 2.0 * width * wave * share * math.sin(phase)
        change = 2.0 * width * width * wave * wave * share * math.cos(phase)
        width = temperature + max(min(change, 0.4 * temperature), -0.4 * temperature)
    whole = math.sqrt(width) * max(1.0 + 2.0 * share * math.cos(wave * centre), 0.5)
    return centre, -0.5 / width, whole


@part
def on_axis(grid, drift, width, q):  # type: ignore[no-untyped-def]
    """The Maxwellian of axis q on its nodes and on its faces: centre and -1/(2 width) of each, ratio of their sums."""
    odd = 1.0 if grid.points[q] % 2 == 1 else -1.0
    node = sampled(grid.per_spacing[q], odd, drift.centre[q], width)
    face = sampled(grid.per_spacing[q], -odd, drift.centre[q], width)
    return node[0], node[1], face[0], face[1], node[2] / face[2]


@part
def make_factors(grid, axis, scratch, at):  # type: ignore[no-untyped-def]
    """For each face in x, by the node below it: M there over M on two nodes before and two behind; from `at` on.

    Zero where there is no such node, and for the closed face of the last one.
    """
    points_x, whole, x, x_face = grid.points[0], (grid.points[0] + 7) // 8 * 8, grid.x, grid.x_face
    centre, narrow, centre_face, narrow_face, ratio = axis
    for row in range(FACTORS):
        for k in range(whole):
            node, exponent = k + row - 1, NONE
            if k < points_x - 1 and 0 <= node < points_x:
                # from the nodes themselves: a mirrored gas has the same factors to the last bit
                face, own = x_face[k] - centre_face, x[node] - centre
                exponent = face * face * narrow_face - own * own * narrow
            scratch[at + row * whole + k] = exponent
        for n in range(at + row * whole, at + row * whole + whole, 8):
            exponents = load(scratch, n)
            store(scratch, n, where_above(exponents, splat(NONE), exponential(exponents) * ratio, splat(0.0)))
    return whole


@part
def product_on_face(speed, nodes, rises):  # type: ignore[no-untyped-def]
    """a M_F v on a face from h of the nodes below and above it and its differences below, across and above."""
    (lower, upper), (below, across, above) = nodes, rises
    add = towards_face(where_negative(speed, above, below), across)
    value = fma(add, where_negative(speed, splat(-0.125), splat(0.125)), where_negative(speed, upper, lower))
    # + 0 makes +0 of -0, whose sign `through_face` would see
    return fma(speed, value, splat(0.0))


@part
def through_face(products, bend, share, donors):  # type: ignore[no-untyped-def]
    """The flux of fourth order, as far as what the nodes below and above the face may lose through it.

    products: P on the face below, this one and the one above; bend: -1/24, 0 on a closed face; donors: what the nodes
    have. A node may lose an eighth of its share through a face against P, and TURNED more for each of its two faces
    where P goes that way: seven eighths where it passes the node, a half through each where it parts there.
    """
    (before, own, after), (below, above) = products, donors
    zero = splat(0.0)
    most_before, most_after = maximum(abs(own), abs(after)) * STEEPEST, maximum(abs(own), abs(before)) * STEEPEST
    before_held = maximum(minimum(before, most_before), zero - most_before)
    after_held = maximum(minimum(after, most_after), zero - most_after)
    little, more = splat((0.5 - TURNED) * share), splat(TURNED * share)
    flux = fma(before_held + after_held, bend, own * (13.0 / 12.0))
    # P = 0 leaves through no face: the same for either direction
    up = where_negative(zero - own, more, zero) + where_negative(zero - before, more, zero)
    down = where_negative(own, more, zero) + where_negative(after, more, zero)
    return maximum(minimum(flux, (little + up) * below), zero - (little + down) * above)


@part
def fluxes_in_slab(slab, bend, stride, along, share, rows, scratch):  # type: ignore[no-untyped-def]
    """The fluxes through the upper faces of a slab's nodes along y or z, in the row `through`.

    Parameters
    ----------
    slab, bend : array, int
        The grid's, and where its row Y_BEND or Z_BEND begins.
    stride : int
        From a node to the next.
    along : tuple of float
        The parts of the speed that belong to this xi_x: of the axis' own velocity free, and times it.
    share : float
        What a face may carry, at most, of what its donor has, 1/time.
    rows : tuple of int
        Where they begin in `scratch`: h, what nodes have, the three parts of M_F a/h, differences, P, fluxes; their
        length.
    """
    relative, donors, (faces, turning, speeds), rise, product, through, size = rows
    # rows of z follow one another as those of y do
    first = bend + (Y_FIRST - Y_BEND) * size
    last = first + (Y_LAST - Y_FIRST) * size
    for n in range(0, size, 8):
        store(scratch, rise + n, load(scratch, relative + n + stride) - load(scratch, relative + n))
    for n in range(0, size, 8):
        s = fma(load(scratch, turning + n), along[1], load(scratch, speeds + n))
        s = fma(load(scratch, faces + n), along[0], s)
        across = load(scratch, rise + n)
        below = where_negative(load(slab, first + n), across, load(scratch, rise + n - stride))
        above = where_negative(load(slab, last + n), across, load(scratch, rise + n + stride))
        nodes = load(scratch, relative + n), load(scratch, relative + n + stride)
        store(scratch, product + n, product_on_face(s, nodes, (below, across, above)))
    for n in range(0, size, 8):
        products = (
            load(scratch, product + n - stride),
            load(scratch, product + n),
            load(scratch, product + n + stride),
        )
        has = (load(scratch, donors + n), load(scratch, donors + n + stride))
        store(scratch, through + n, through_face(products, load(slab, bend + n), share, has))


@part
def update_maxwellian(g, cell, grid, drift, mix, scratch, result):  # type: ignore[no-untyped-def]
    """`drift.apply` with this reconstruction."""
    points_x, points_y, points_z = grid.points
    slab_size, x, x_face, slab = grid.slab_size, grid.x, grid.x_face, grid.slab
    guard = guard_of(points_z)
    row = slab_size + 2 * guard
    relative, rises, product, through_z = guard, row + guard, 2 * row + guard, 3 * row + guard
    product_before, product_x, product_after = 4 * row + guard, 5 * row + guard, 6 * row + guard
    through_x, through_y = 7 * row + guard, 8 * row + guard
    inverse, turning_y, turning_z = 9 * row + guard, 10 * row + guard, 11 * row + guard
    turns, speeds_y, speeds_z = 12 * row + guard, 13 * row + guard, 14 * row + guard
    donors, donors_next = 15 * row + guard, 16 * row + guard
    across_x, faces_y, faces_z = 17 * row + guard, 18 * row + guard, 19 * row + guard
    factors = ROWS * row
    a, rising_x, falling_x = drift.own, drift.rising_x, drift.falling_x
    rising_y, falling_y = splat(drift.rising_y), splat(drift.falling_y)
    per_x, per_y, per_z = grid.per_spacing
    push_x, push_y, push_z = drift.push[0] * per_x, drift.push[1] * per_y, drift.push[2] * per_z
    (flow_x, flow_y), (up_x, down_x, up_y, down_y) = drift.flow, drift.shears
    old, weight_old, weight_new, dt = mix.old, mix.weight_old, mix.weight_new, mix.dt
    has_y, has_z = points_y > 1, points_z > 1
    mix_old = weight_old != 0.0
    zero = splat(0.0)

    # what a face of each direction may carry, at most, of what its donor has
    most_x, most_y, most_z = drift.fastest
    fastest = most_x + most_y + most_z
    lose = SHARE / max(fastest * dt, 1e-200)
    share_x, share_y, share_z = most_x * lose, most_y * lose, most_z * lose

    # the Maxwellian, and the part of the faces' speeds over h that is the same for every xi_x
    width = width_of(drift, grid.half_width, grid.dimensions)
    whole = make_factors(grid, on_axis(grid, drift, width, 0), scratch, factors)
    node_y, narrow_y, face_y, narrow_face_y, ratio_y = on_axis(grid, drift, width, 1)
    node_z, narrow_z, face_z, narrow_face_z, ratio_z = on_axis(grid, drift, width, 2)
    for n in range(0, slab_size, 8):
        y, yf = load(slab, Y * slab_size + n), load(slab, Y_FACE * slab_size + n)
        z, zf = load(slab, Z * slab_size + n), load(slab, Z_FACE * slab_size + n)
        log_y, log_z = (y - node_y) * (y - node_y) * narrow_y, (z - node_z) * (z - node_z) * narrow_z
        open_y, open_z = load(slab, Y_OPEN * slab_size + n), load(slab, Z_OPEN * slab_size + n)
        speed_y = y + flow_y
        turn = speed_y * where_positive(speed_y, rising_y, falling_y)
        store(scratch, across_x + n, speed_y * where_positive(speed_y, splat(up_y[0]), splat(down_y[0])) * -per_x)
        store(scratch, inverse + n, exponential(zero - (log_y + log_z)))
        store(scratch, turns + n, turn)
        store(scratch, product_x + n, zero)
        store(scratch, through_x + n, zero)
        # M on the face goes with the speed: it changes no sign
        if has_y:
            across = exponential((yf - face_y) * (yf - face_y) * narrow_face_y + log_z) * (open_y * ratio_y)
            speed_yf = yf + flow_y
            rise_yf = where_positive(speed_yf, rising_y, falling_y) * yf
            turn_yf = speed_yf * (rise_yf + where_positive(speed_yf, splat(up_y[1]), splat(down_y[1])))
            store(scratch, faces_y + n, across)
            store(scratch, turning_y + n, across * yf)
            store(scratch, speeds_y + n, across * (splat(push_y) - turn_yf * per_y))
        if has_z:
            across = exponential((zf - face_z) * (zf - face_z) * narrow_face_z + log_y) * (open_z * ratio_z)
            shear = speed_y * where_positive(speed_y, splat(up_y[2]), splat(down_y[2]))
            store(scratch, faces_z + n, across)
            store(scratch, turning_z + n, across * zf)
            store(scratch, speeds_z + n, across * (splat(push_z) - (zf * turn + shear) * per_z))

    for k in range(-1, points_x):
        # along x, one slab ahead of the others: P on the face below it, and what nodes have
        base, at = cell + k * slab_size, k * slab_size
        first = splat(-1.0 if k + 1 == 0 else 1.0)
        last = splat(-1.0 if k + 1 == points_x - 2 else 1.0)
        f0, f1, f2, f3 = 0.0, 0.0, 0.0, 0.0
        sx0, sx1 = 0.0, 0.0
        if k + 1 < points_x - 1:
            xf, face = x_face[k + 1], factors + k + 1
            f0, f1 = scratch[face], scratch[face + whole]
            f2, f3 = scratch[face + 2 * whole], scratch[face + 3 * whole]
            speed = xf + flow_x
            shear = up_x if speed > 0.0 else down_x
            rise = rising_x if speed > 0.0 else falling_x
            sx0 = push_x - per_x * ((a + rise * speed) * xf + shear[0] * speed)
            sx1 = -per_x * xf
        for n in range(0, slab_size, 8):
            own, upper = load(g, base + slab_size + n) * f1, load(g, base + 2 * slab_size + n) * f2
            across = upper - own
            below = where_negative(first, across, own - load(g, base + n) * f0)
            above = where_negative(last, across, load(g, base + 3 * slab_size + n) * f3 - upper)
            s = fma(load(scratch, turns + n), sx1, load(scratch, across_x + n) + sx0)
            store(scratch, product_after + n, product_on_face(s, (own, upper), (below, across, above)))
        if -1 <= k < points_x - 1:
            for n in range(0, slab_size, 8):
                has = fma(load(result, at + slab_size + n), dt, load(g, base + slab_size + n))
                store(scratch, donors_next + n, maximum(has, zero))
        if k >= 0:
            speed = x[k] + flow_x
            shear = up_x if speed > 0.0 else down_x
            along = a + (rising_x if speed > 0.0 else falling_x) * speed
            for n in range(0, slab_size, 8):
                prefetch(old, base + 2 * slab_size + n)
                store(scratch, relative + n, load(g, base + n) * load(scratch, inverse + n))
            # one direction after the other: few numbers at a time, which registers can hold
            bend_x = splat(-1.0 / 24.0 if k < points_x - 1 else 0.0)
            for n in range(0, slab_size, 8):
                products = (
                    load(scratch, product_before + n),
                    load(scratch, product_x + n),
                    load(scratch, product_after + n),
                )
                f = through_face(products, bend_x, share_x, (load(scratch, donors + n), load(scratch, donors_next + n)))
                store(result, at + n, load(result, at + n) + (load(scratch, through_x + n) - f))
                store(scratch, through_x + n, f)
            if has_y:
                rows = (relative, donors, (faces_y, turning_y, speeds_y), rises, product, through_y, slab_size)
                speeds = (-shear[1] * speed * per_y, -along * per_y)
                fluxes_in_slab(slab, Y_BEND * slab_size, points_z, speeds, share_y, rows, scratch)
            if has_z:
                rows = (relative, donors, (faces_z, turning_z, speeds_z), rises, product, through_z, slab_size)
                speeds = (-shear[2] * speed * per_z, -along * per_z)
                fluxes_in_slab(slab, Z_BEND * slab_size, 1, speeds, share_z, rows, scratch)
            for n in range(0, slab_size, 8):
                change = load(result, at + n)
                if has_y:
                    change = change + (load(scratch, through_y + n - points_z) - load(scratch, through_y + n))
                if has_z:
                    change = change + (load(scratch, through_z + n - 1) - load(scratch, through_z + n))
                value = fma(change, dt, load(g, base + n)) * weight_new
                if mix_old:
                    value = fma(load(old, base + n), weight_old, value)
                store(result, at + n, value)
        product_before, product_x, product_after = product_x, product_after, product_before
        donors, donors_next = donors_next, donors
