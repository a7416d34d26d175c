"""The explicit part of a stage: transport, drift and an operator's source, the drift in substeps where it is fast."""

from __future__ import annotations

import math

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import fma, load, splat, store
from rvm_mpi.kinetic.drift import Mix, apply
from rvm_mpi.kinetic.gaussian import discrete_gaussian
from rvm_mpi.kinetic.realisable import EXACT, REPLACED
from rvm_mpi.step.relaxation import blend
from rvm_mpi.time_limits import FITS


@part
def drift_substeps(dt, crossing, drifting, courant):  # type: ignore[no-untyped-def]
    """In how many substeps a cell's drift is taken by itself; 0 where it goes together with transport.

    Parameters
    ----------
    crossing, drifting : float
        Sums of max|a|/h over the directions of space and of velocity.
    courant : float
        The largest Courant number of a forward Euler step.
    """
    if dt * (crossing + drifting) <= FITS * courant:
        return 0
    wanted = dt * drifting / courant
    # a rate that is no number ends the run after the sweep, which must not go on for ever before
    return max(1, math.ceil(wanted)) if wanted < 1e6 else 1


@part
def explicit_part(grid, model, cell, turn, mix, fields, work, first):  # type: ignore[no-untyped-def]
    """old g^n + new (g + dt L(g)), in `work.result`, which holds the change by transport before.

    Parameters
    ----------
    cell : Here
    turn : Drift
    mix : Mix
        Its `old` is g^n.
    first : tuple (substeps, weight)
        In how many substeps the drift is taken, and the weight of the first Gaussian: one that a drift in substeps must
        take along.

    Returns
    -------
    int, float
        What `discrete_gaussian` says of that Gaussian, else EXACT, and the weight that it has yet to be added with.
    """
    result, (substeps, weight_first) = work.result, first
    if model.explicit:
        at = (cell.j * (fields.growth.shape[1]) + cell.i) * grid.block
        for n in range(0, grid.block, 8):
            store(result, n, load(result, n) + load(fields.source, at + n))
    if substeps == 0:
        apply(fields.g, cell.block, grid, turn, mix, work.scratch, result)
        return EXACT, weight_first
    share, answer = 0.0, EXACT
    if weight_first > 0.0 and model.relaxes:
        sums = fields.start.sums[cell.j, cell.i]
        gaussian = work.gaussian
        density = blend(model.nu, grid.dimensions, sums, sums, (1.0, 0.0, 1.0), sums, 1.0, gaussian)
        answer = discrete_gaussian(
            density, gaussian.mean, gaussian.tensor, grid, work.fit, gaussian.block, gaussian.sums
        )
        if answer > REPLACED:
            return answer, 0.0
        share = weight_first * density / gaussian.sums[0]
    take_substeps(fields.g, cell, grid, turn, mix, share, substeps, work)
    return answer, 0.0


@part
def take_substeps(g, cell, grid, turn, mix, share, substeps, work):  # type: ignore[no-untyped-def]
    """The explicit part of a stage where the drift is too fast for it: `work.result` from the change by transport.

    In the frame that moves with the drift (Lawson), with P the drift over dt: where g^n has a weight, it and `share` of
    the Gaussian in `work` have moved for dt, P(old g^n + share G) + new (g + dt T(g)), where it has none,
    P(new (g + dt T(g))). P is the strong stability preserving Runge-Kutta method of second order with substeps + 1
    stages (Spiteri and Ruuth, SIAM J. Numer. Anal. 40, 2002), each a forward Euler step over dt/substeps; so g stays
    positive where each of these and the transport keep it so.
    """
    block, result, dt = grid.block, work.result, mix.dt
    at = grid.guard
    start, target, spare = work.flow
    for n in range(0, block, 8):
        moved = fma(load(result, n), dt, load(g, cell.block + n)) * mix.weight_new
        if mix.weight_old > 0.0:
            before = load(mix.old, cell.block + n) * mix.weight_old
            if share > 0.0:
                before = fma(load(work.gaussian.block, n), share, before)
            store(start, at + n, before)
            store(result, n, moved)
        else:
            store(start, at + n, moved)
            store(result, n, splat(0.0))
    current = start
    for substep in range(substeps + 1):
        weight = substeps / (substeps + 1) if substep == substeps else 1.0
        # one together, to the last bit: no mass is lost
        now = Mix(start, 1.0 - weight, weight, dt / substeps)
        here = target[at : at + block]
        for n in range(0, block, 8):
            store(here, n, splat(0.0))
        apply(current, at, grid, turn, now, work.scratch, here)
        current, target, spare = target, spare, target
    for n in range(0, block, 8):
        store(result, n, load(result, n) + load(current, at + n))
