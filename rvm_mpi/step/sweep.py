"""One stage of the time step, swept over the cells of a rank: each cell's block is finished while it is in cache.

For a cell, in this order: fluxes through its upper faces and their moments; the rates of mass, momentum and energy and
with them d_t omega; drift and transport of g; correction of g to the carried moments; relaxation to the Gaussian.
"""

from __future__ import annotations

import math

from rvm_mpi.compiling.declare import kernel, part
from rvm_mpi.compiling.simd import fma, load, maximum, minimum, splat, store, total
from rvm_mpi.grid.velocity import EDGE, SPEED2, VALID
from rvm_mpi.kinetic.drift import Mix
from rvm_mpi.kinetic.realisable import REPLACED, TOO_COLD
from rvm_mpi.kinetic.transport import UpperFaces, upper_fluxes
from rvm_mpi.kinetic.transport_thermal import MovingFaces, moving_fluxes
from rvm_mpi.step.carried import carry, mean_drag, net_rates, state_of, step_cooling, thermal_energy
from rvm_mpi.step.data import (
    HEALTHY,
    NO_CORRECTION,
    NO_GAUSSIAN,
    NOT_A_NUMBER,
    NOT_POSITIVE,
    TOO_COLD_FOR_GRID,
    here,
    lay_out,
)
from rvm_mpi.step.explicit import drift_substeps, explicit_part
from rvm_mpi.step.relaxation import correct_signed, mean_depth, relax, sums_to_have
from rvm_mpi.step.scaling import face_omega, frame_drift
from rvm_mpi.step.scheme import Weights, weights
from rvm_mpi.step.thermal import face_frames, frame_rates, is_side, plain, speed_of, thermal_drift


@part
def cross(grid, space, model, fields, cell, work):  # type: ignore[no-untyped-def]
    """The fluxes through the upper faces of a cell, a ghost cell where an index is negative, and their moments.

    A ghost cell's moments are left where the cell beyond the face looks for those of its lower face.
    """
    if model.thermal:
        cross_moving(grid, space, fields, cell, work)
    else:
        cross_scaled(grid, space, model, fields, cell, work)
    moments = work.moments
    for q in range(5):
        if cell.j < 0:
            moments.south[cell.i, q] = moments.north[q]
        elif cell.i < 0:
            moments.west[q] = moments.east[q]


@part
def cross_moving(grid, space, fields, cell, work):  # type: ignore[no-untyped-def]
    """The fluxes where each cell has a frame of its own."""
    j, i, y, x = cell.j, cell.i, cell.y, cell.x
    moments, strips = work.moments, work.strips
    along_x, along_y, per_dx, per_dy = 0, 0, 0.0, 0.0
    own = plain(fields.begin.omega, fields.begin.mean, (y, x))
    east, north, side_x, side_y = (own, own), (own, own), False, False
    if space.dimensions >= 1 and j >= 0:
        east, side_x = face_frames(space, fields.begin, y, x, 0, 1), is_side(space, y, x, 0)
        along_x, per_dx = grid.block, space.per_dx
    if space.dimensions == 2 and i >= 0:
        north, side_y = face_frames(space, fields.begin, y, x, 1, 0), is_side(space, y, x, 1)
        along_y, per_dy = (space.nx + 2 * space.wx) * grid.block, space.per_dy
    enters = (side_x and i < 0, side_x and i >= 0, side_y and j < 0, side_y and j >= 0)
    upper = MovingFaces(along_x, along_y, per_dx, per_dy, (east[0], east[1], north[0], north[1]), enters)
    west, south = strips.west if j >= 0 else strips.spare, strips.south if i >= 0 else strips.spare
    lower = (west, south, max(i, 0) * grid.block)
    moving_fluxes(fields.g, cell.block, grid, upper, lower, work.result, moments.east, moments.north)


@part
def cross_scaled(grid, space, model, fields, cell, work):  # type: ignore[no-untyped-def]
    """The fluxes where all velocities are counted from zero."""
    j, i, y, x = cell.j, cell.i, cell.y, cell.x
    omega, moments, strips = fields.begin.omega, work.moments, work.strips
    omega_e, omega_n = (omega[y, x], omega[y, x]), (omega[y, x], omega[y, x])
    along_x, along_y, per_dx, per_dy = 0, 0, 0.0, 0.0
    if space.dimensions >= 1 and j >= 0:
        omega_e = face_omega(model.conservative, omega, y, x, 0, 1)
        along_x, per_dx = grid.block, space.per_dx
    if space.dimensions == 2 and i >= 0:
        omega_n = face_omega(model.conservative, omega, y, x, 1, 0)
        along_y, per_dy = (space.nx + 2 * space.wx) * grid.block, space.per_dy
    upper = UpperFaces(along_x, along_y, per_dx, per_dy, (omega_e[0], omega_e[1], omega_n[0], omega_n[1]))
    west, south = strips.west if j >= 0 else strips.spare, strips.south if i >= 0 else strips.spare
    lower = (west, south, max(i, 0) * grid.block, strips.faces)
    upper_fluxes(fields.g, cell.block, grid, upper, lower, work.result, moments.east, moments.north)


@part
def mix(grid, work, own, share, out, at, watched):  # type: ignore[no-untyped-def]
    """out = own * result * factor + share * Gaussian, from the place `at` on.

    Returns the smallest and the largest value and, where `watched`, the sums of 1 and |xi|^2 over the outermost nodes.
    """
    block, factor_slab = work.result, work.correction.factor_slab
    gaussian, extremes = work.gaussian.block, work.extremes
    points_x, slab_size, x, slab = grid.points[0], grid.slab_size, grid.x, grid.slab
    low, high = splat(1e300), splat(-1e300)
    edge_mass, edge_energy = splat(0.0), splat(0.0)
    for k in range(points_x):
        f = work.correction.factor_x[k] * own
        base = k * slab_size
        edge = (VALID if k == 0 or k == points_x - 1 else EDGE) * slab_size
        square = splat(x[k] * x[k])
        for n in range(0, slab_size, 8):
            value = load(block, base + n) * (load(factor_slab, n) * f)
            if share > 0.0:
                value = fma(load(gaussian, base + n), share, value)
            valid = load(slab, VALID * slab_size + n)
            value = value * valid
            store(out, at + base + n, value)
            padding = (splat(1.0) - valid) * 1e300
            low = minimum(low, value + padding)
            high = maximum(high, value - padding)
            if watched:
                outer = value * load(slab, edge + n)
                edge_mass = edge_mass + outer
                edge_energy = fma(outer, load(slab, SPEED2 * slab_size + n) + square, edge_energy)
    store(extremes, 0, low)
    store(extremes, 8, high)
    smallest, largest = extremes[0], extremes[8]
    for lane in range(1, 8):
        smallest, largest = min(smallest, extremes[lane]), max(largest, extremes[8 + lane])
    return smallest, largest, total(edge_mass), total(edge_energy)


@part
def finish(grid, cell, share, whole, fields, work, watched):  # type: ignore[no-untyped-def]
    """Write a cell's block and its sums (10), and report on them; False where they are no numbers."""
    sums, fitted, done = work.sums.result, work.gaussian.sums, fields.new.sums[cell.j, cell.i]
    for q in range(10):
        done[q] = sums[q] / whole
        if share > 0.0:
            done[q] += fitted[q] * (share / whole)
    own = 1.0 / whole
    found = mix(grid, work, own, share / whole, fields.out, cell.block, watched)
    trace = done[4] + done[7] + done[9]
    report = fields.report[cell.j, cell.i]
    report.smallest, report.largest = found[0], found[1]
    report.box_mass, report.box_energy = found[2] / done[0], found[3] / trace
    # what is no number anywhere in g is none in its sums
    return math.isfinite(done[0] + trace)


@part
def problem(answer):  # type: ignore[no-untyped-def]
    """A cell's status from what `discrete_gaussian` says."""
    if answer <= REPLACED:
        return HEALTHY
    return TOO_COLD_FOR_GRID if answer == TOO_COLD else NO_GAUSSIAN


@part
def advance(grid, space, model, stage, dt, fields, cell, work):  # type: ignore[no-untyped-def]
    """Take a cell through a stage, the changes by transport known; returns its status."""
    j, i, d = cell.j, cell.i, grid.dimensions
    rate, wanted, report = work.moments.rate, work.sums.wanted, fields.report[j, i]
    if model.explicit:
        rate[4] += fields.heating[j, i]
    first, begin = fields.start.sums[j, i], fields.begin.carried[j, i]
    omega = fields.begin.omega[cell.y, cell.x]
    density, ux, uy, uz, energy = state_of(grid, model, begin, fields.begin.sums[j, i], omega)
    kinetic_energy = 0.5 * density * (ux * ux + uy * uy + uz * uz)
    thermal = energy - kinetic_energy
    if not (density > 0.0 and thermal > 0.0):
        return NOT_POSITIVE
    temperature = 2.0 * thermal / (d * density)

    # cooling: one rate for drag and scaling
    beta = mean_drag(model.cooling, stage.time, density, temperature, dt)
    own = fields.growth[j, i] + beta
    if model.kinetic:
        own = 0.5 * (rate[4] / energy - rate[0] / density) + beta * (kinetic_energy / energy)
    omega_new, taken, carried = fields.omega_end[j, i], 0.0, fields.new.carried[j, i]
    if model.carried:
        positive, taken = carry(d, model.cooling, stage, dt, fields.start.carried[j, i], begin, rate, carried)
        if not positive:
            return NOT_POSITIVE
    if model.thermal:
        turning = frame_rates(model, d, stage, dt, fields, cell, rate, taken)
        turn, crossing, drifting = thermal_drift(grid, space, fields.begin, cell, turning)
    else:
        of_g = (beta, (ux / omega, uy / omega, uz / omega), temperature / (omega * omega))
        turn, crossing, drifting = frame_drift(grid, space, model.conservative, fields.begin.omega, cell, own, of_g)
    report.transport, report.drift = crossing, drifting

    z = fields.depth[j, i] if stage.number > 0 or model.explicit else 0.0
    weight = weights(stage, z)
    now = Mix(fields.old, weight.old, weight.new, dt)
    substeps = drift_substeps(dt, crossing, drifting, model.courant)
    replaced, lacking = explicit_part(grid, model, cell, turn, now, fields, work, (substeps, weight.first))
    if replaced > REPLACED:
        return problem(replaced)

    if model.carried:
        taken *= stage.reach
        if model.kinetic:
            omega_new = math.sqrt(2.0 * carried[4] / (d * carried[0]))
        elif model.thermal:
            omega_new = speed_of(thermal_energy(carried), carried[0], d)
            for q in range(3):
                fields.new.mean[cell.y, cell.x, q] = carried[1 + q] / carried[0]
    else:
        share = stage.reach * (1.0 - stage.old)
        taken = share * step_cooling(thermal, density, d, model.cooling, stage.time, dt)
    # of f's energy; where velocities are counted from the mean, of what they have
    report.dissipated, report.cooling_rate = taken, 2.0 * beta * (1.0 if model.thermal else thermal / energy)
    if model.explicit:
        report.dissipated = -stage.reach * (1.0 - stage.old) * dt * fields.heating[j, i]
        report.cooling_rate = abs(fields.heating[j, i]) / energy
    sums_to_have(grid, model, weight, lacking, carried, omega_new, first, work)
    speed2 = (wanted[1] ** 2 + wanted[2] ** 2 + wanted[3] ** 2) / wanted[0] ** 2
    temperature_new = (2.0 * wanted[4] / wanted[0] - speed2) / d
    if not (wanted[0] > 0.0 and temperature_new > 0.0):
        return NOT_POSITIVE

    if model.relaxes and not model.explicit and stage.number == 0:
        after = (wanted[0] * grid.weight, temperature_new * omega_new * omega_new)
        z = mean_depth(model, dt, (density, temperature), after)
        fields.depth[j, i] = z
        weight = weights(stage, z)
    left = Weights(weight.old, weight.new, lacking, weight.last, weight.whole)
    mismatch, answer, share = relax(grid, model, left, temperature_new, first, work)
    if model.explicit and mismatch >= 0.0:
        mismatch = correct_signed(grid, model, share, weight.whole, temperature_new, work)
        share = 0.0
    if mismatch < 0.0:
        return NO_CORRECTION
    report.mismatch = mismatch
    report.replaced = 1.0 if replaced == REPLACED or answer == REPLACED else 0.0
    fields.new.omega[cell.y, cell.x] = omega_new
    watched = stage.final or dt == 0.0
    numbers = finish(grid, cell, share, weight.whole, fields, work, watched)
    return problem(answer) if numbers else NOT_A_NUMBER


@kernel
def sweep(grid, space, model, stage, dt, fields, buffer):  # type: ignore[no-untyped-def]
    """One stage for all cells of a rank.

    Parameters
    ----------
    grid, space, model : data.Grid, data.Space, data.Model
    stage : scheme.Stage
    dt : float
        Length of the step; with 0 a stage only measures.
    fields : data.Fields
    buffer : flat array
        Work space (`data.work_space`).
    """
    work, _ = lay_out(grid, space.nx, buffer)
    for n in range(0, grid.block, 8):
        store(work.strips.west, n, splat(0.0))
    for n in range(0, space.nx * grid.block, 8):
        store(work.strips.south, n, splat(0.0))
    work.moments.west[:] = 0.0
    work.moments.south[:] = 0.0
    # ghost cells first, below and left of the others: the sweep needs the fluxes through their upper faces
    for j in range(0 if space.dimensions < 2 else -1, space.ny):
        for i in range(0 if space.dimensions < 1 else -1, space.nx):
            if i < 0 and j < 0:
                continue
            cell = here(grid, space, j, i)
            cross(grid, space, model, fields, cell, work)
            if i < 0 or j < 0:
                continue
            net_rates(grid, space, fields.sides, cell, work.moments)
            fields.report[j, i].status = advance(grid, space, model, stage, dt, fields, cell, work)
