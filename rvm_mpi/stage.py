"""One stage of the time step, swept over the cells of a rank: each cell's block is finished while it is in cache.

For a cell, in this order: fluxes through its upper faces and their moments; the rates of mass, momentum and energy and
with them d_t omega; drift and transport of g; correction of g to the carried moments; relaxation to the Gaussian. A
stage reads the ghosted g of the stage before and writes the other array; the sums over the velocity grid are
kept as plain sums over the nodes, without the volume of a velocity cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from rvm_mpi.collisions.es_bgk import FAILED, REPLACED, TOO_COLD, discrete_gaussian, discrete_maxwellian
from rvm_mpi.estimates import FITS
from rvm_mpi.kernels import kernel, part
from rvm_mpi.kinetic import drift
from rvm_mpi.kinetic.conservation import SUMS, add_correction, correct, weighted_sums
from rvm_mpi.kinetic.transport import PIECE, upper_fluxes
from rvm_mpi.simd import load, maximum, minimum, splat, store, total
from rvm_mpi.velocity import EDGE, SPEED2, VALID, VelocityGrid, Y

#: columns of the diagnostics a stage leaves of each cell; the rates are sums of max|a|/h over the directions
SMALLEST, LARGEST, MISMATCH, GAUSSIANS_REPLACED, TRANSPORT, DRIFT, DISSIPATED, COOLING_RATE, STATUS = range(9)
#: shares of mass and energy of the outermost velocities, at the end of a step and of a stage of no length
BOX_MASS, BOX_ENERGY = 9, 10
DIAGNOSTICS = 11
#: what STATUS says
HEALTHY, TOO_COLD_FOR_GRID, NO_GAUSSIAN, NO_CORRECTION, NOT_POSITIVE, NOT_A_NUMBER = range(6)


class Grid(NamedTuple):
    """The velocity grid as numbers and arrays for the kernels (`velocity.py`).

    stencil (2, taps) are the coefficients of the drift's linear reconstruction, None for Van Leer's; bounded: whether
    its fluxes are kept from making g negative.
    """

    dimensions: int
    points: tuple[int, int, int]
    slab_size: int
    block: int
    below: int
    weight: float
    x: np.ndarray
    x_face: np.ndarray
    slab: np.ndarray
    nodes: np.ndarray
    per_spacing: tuple[float, float, float]
    half_width: tuple[float, float, float]
    stencil: np.ndarray | None
    bounded: bool


class Space(NamedTuple):
    """The cells of a rank: counts, ghost widths of g, 1/dx and 1/dy, 0 in an unused direction."""

    dimensions: int
    nx: int
    ny: int
    wx: int
    wy: int
    per_dx: float
    per_dy: float


class Model(NamedTuple):
    """What is solved: numbers the kernels branch on or multiply by.

    `courant` is the largest Courant number that transport and drift are taken at together: beyond it a cell's drift is
    taken by itself, in as many substeps as it needs.
    """

    kinetic: bool
    conservative: bool
    collisions: bool
    nu: float
    relaxation: float
    density_power: float
    temperature_power: float
    cooling: float
    courant: float


class Cells(NamedTuple):
    """Fields of the cells at one time level: what a stage reads, and what it writes of the next.

    omega has two ghost cells in each direction in use; carried (ny, nx, 5) are rho, rho u, E of f; sums
    (ny, nx, 10) those of 1, xi, xi xi over g's nodes.
    """

    omega: np.ndarray
    carried: np.ndarray
    sums: np.ndarray


def kernel_grid(grid: VelocityGrid, reconstruction: str = "van-leer") -> Grid:
    """The grid's numbers and arrays, and the drift's reconstruction by its name, as the kernels take them."""
    y = grid.slab[Y, : grid.slab_points]
    return Grid(
        grid.dimensions,
        grid.points,
        grid.slab_size,
        grid.block,
        int(np.count_nonzero(y < 0)) if grid.points[1] > 1 else 0,
        grid.weight,
        grid.x,
        grid.x_face,
        grid.slab.reshape(-1),
        grid.nodes,
        (1 / grid.spacing[0], 1 / grid.spacing[1], 1 / grid.spacing[2]),
        grid.half_width,
        None if reconstruction == "van-leer" else drift.stencil(drift.ORDERS[reconstruction]),
        reconstruction in drift.POSITIVE,
    )


class Work(NamedTuple):
    """Work space of a stage: blocks of one cell, one row of fluxes, and small arrays."""

    west: np.ndarray
    south: np.ndarray
    faces: np.ndarray
    result: np.ndarray
    gaussian: np.ndarray
    flow: tuple[np.ndarray, np.ndarray, np.ndarray]
    scratch: np.ndarray
    south_moments: np.ndarray
    rates: np.ndarray
    extremes: np.ndarray
    vectors: np.ndarray
    correction: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    fit: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]

    @classmethod
    def create(cls, grid: Grid, nx: int) -> Work:
        """Work space for rows of nx cells."""
        from rvm_mpi.domain import aligned

        nvx = grid.points[0]
        guarded = (grid.block + 2 * drift.reach(grid.points[2], grid.slab_size),)
        return cls(
            west=aligned((grid.block,)),
            south=aligned((grid.block * nx,)),
            faces=aligned((2 * PIECE,)),
            result=aligned((grid.block,)),
            gaussian=aligned((grid.block,)),
            flow=(aligned(guarded), aligned(guarded), aligned(guarded)),
            scratch=aligned((drift.scratch_size(grid.points, grid.slab_size),)),
            south_moments=np.zeros((nx, 5)),
            rates=np.zeros(11),
            extremes=np.zeros(16),
            vectors=np.zeros((14, SUMS)),
            correction=(
                np.ones(nvx),
                aligned((grid.slab_size,)),
                np.zeros(5 * nvx),
                np.zeros((5, 5)),
                np.zeros((3, 5)),
            ),
            fit=(np.zeros(10), np.zeros(75), np.zeros(600), np.zeros((10, 10)), np.zeros((5, 10))),
        )


@part
def cooled(thermal, density, d, cooling, dt):  # type: ignore[no-untyped-def]
    """Thermal energy d rho T/2 after dt of dT/dt = -2 cooling rho T^(3/2), exactly (Haff), forwards or backwards."""
    root = math.sqrt(2.0 * thermal / (d * density))
    return thermal / (1.0 + cooling * density * root * dt) ** 2


@part
def relaxation_rate(model, density, temperature):  # type: ignore[no-untyped-def]
    """tau(rho, T)/eps of f."""
    return model.relaxation * density**model.density_power * temperature**model.temperature_power


@part
def through(moments, weight, flux):  # type: ignore[no-untyped-def]
    """Rates of mass, momentum and energy of f through a face, from the moments of its flux (`transport.py`)."""
    for q in range(4):
        flux[q] = weight * moments[q]
    flux[4] = 0.5 * weight * moments[4]


@part
def face_omega(upwind, omega, j, i, down, right):  # type: ignore[no-untyped-def]
    """omega at the upper face of cell (j, i) along (down, right), as this cell and as the next one see it.

    Upwind where the moments are carried by the fluxes: velocities that go up carry the lower cell's omega, those that
    go down the upper cell's, each reconstructed with Van Leer's limiter, so that what crosses a face is what the gas of
    that side sends, however much omega jumps. Without carried moments nothing but the drift takes back what a jump of
    omega does to g, and it does so best with the mean.
    """
    b, c = omega[j, i], omega[j + down, i + right]
    if not upwind:
        return 0.5 * (b + c), 0.5 * (b + c)
    a, e = omega[j - down, i - right], omega[j + 2 * down, i + 2 * right]
    return b + limited(b - a, c - b), c - limited(c - b, e - c)


@part
def limited(a, b):  # type: ignore[no-untyped-def]
    """Half of Van Leer's slope."""
    return a * b / (a + b) if a * b > 0.0 else 0.0


@part
def blend(nu, d, first, sums, wanted, temperature, weight_first, weight_last, whole, centre, tensor):  # type: ignore[no-untyped-def]
    """Mean and temperature tensor of weight_first G[g^n] + weight_last G[result], as one Gaussian; returns its sum.

    The result's own stress follows from the stage's implicit equation in closed form:
    (whole - weight_last nu) rho Theta = second moments of the explicit part and of the first Gaussian
    + weight_last (1 - nu) rho T I - (whole - weight_last) rho u u.

    Parameters
    ----------
    first, sums : (>= 10,) arrays
        Sums 1, xi, xi xi of g^n and of the explicit part.
    wanted : (5,) array
        Sums 1, xi, |xi|^2/2 of the result; `temperature` is the one they give.
    centre, tensor : arrays
        Receive the mean (3) and the tensor (6).
    """
    share = weight_first + weight_last
    rho0, rho = first[0], wanted[0]
    trace0 = (first[4] + first[7] + first[9]) - (first[1] ** 2 + first[2] ** 2 + first[3] ** 2) / rho0
    density = (weight_first * rho0 + weight_last * rho) / share
    for i in range(3):
        centre[i] = (weight_first * first[1 + i] + weight_last * wanted[1 + i]) / (share * density)
    q = 0
    for a in range(3):
        for b in range(a, 3):
            own0, own = 0.0, 0.0
            if a == b and a < d:
                own0 = (1.0 - nu) * trace0 / d
                own = (1.0 - nu) * rho * temperature
            uu0 = first[1 + a] * first[1 + b] / rho0
            uu = wanted[1 + a] * wanted[1 + b] / rho
            second0 = own0 + nu * (first[4 + q] - uu0) + uu0
            stress = (sums[4 + q] + weight_first * second0 + weight_last * own - (whole - weight_last) * uu) / (
                whole - weight_last * nu
            )
            second = own + nu * stress + uu
            tensor[q] = (weight_first * second0 + weight_last * second) / (share * density) - centre[a] * centre[b]
            q += 1
    return density


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
def take_substeps(g, old, cell, grid, rates, second, weight_new, gaussian, dt, substeps, work):  # type: ignore[no-untyped-def]
    """The explicit part of a stage where the drift is too fast for it: `work.result` from the change by transport.

    Heun's method in the frame that moves with the drift (Lawson): with P the drift over dt, the first stage is
    P(g + dt T(g)), the second P(1/2 old + gaussian * work.gaussian) + weight_new (g + dt T(g)). P is the strong
    stability preserving Runge-Kutta method of second order with substeps + 1 stages (Spiteri and Ruuth, SIAM J. Numer.
    Anal. 40, 2002), each a forward Euler step over dt/substeps; so g stays positive where each of these and the
    transport keep it so.
    """
    block, result = grid.block, work.result
    at = drift.reach(grid.points[2], grid.slab_size)
    start, target, spare = work.flow
    for n in range(0, block, 8):
        moved = load(g, cell + n) + load(result, n) * dt
        if second:
            before = load(old, cell + n) * 0.5
            if gaussian > 0.0:
                before = before + load(work.gaussian, n) * gaussian
            store(start, at + n, before)
            store(result, n, moved * weight_new)
        else:
            store(start, at + n, moved)
            store(result, n, splat(0.0))
    current = start
    for substep in range(substeps + 1):
        last = substep == substeps
        weight_start, weight = (1.0 / (substeps + 1), substeps / (substeps + 1)) if last else (0.0, 1.0)
        here = target[at : at + block]
        for n in range(0, block, 8):
            store(here, n, splat(0.0))
        now = dt / substeps
        drift.apply(grid.stencil, current, at, grid, rates, start, weight_start, weight, now, work.scratch, here)
        current, target, spare = target, spare, target
    for n in range(0, block, 8):
        store(result, n, load(result, n) + load(current, at + n))


@part
def mix(block, factor_x, factor_slab, own, gaussian, share, points_x, slab_size, x, slab, out, at, watched, extremes):  # type: ignore[no-untyped-def]
    """out = own * block * factor + share * gaussian.

    `extremes` receives the smallest and largest value and, where `watched`, the sums of 1 and |xi|^2 over the
    outermost nodes.
    """
    low, high = splat(1e300), splat(-1e300)
    edge_mass, edge_energy = splat(0.0), splat(0.0)
    for k in range(points_x):
        f = factor_x[k] * own
        base = k * slab_size
        edge = (VALID if k == 0 or k == points_x - 1 else EDGE) * slab_size
        square = splat(x[k] * x[k])
        for n in range(0, slab_size, 8):
            value = load(block, base + n) * (load(factor_slab, n) * f)
            if share > 0.0:
                value = value + load(gaussian, base + n) * share
            valid = load(slab, VALID * slab_size + n)
            value = value * valid
            store(out, at + base + n, value)
            padding = (splat(1.0) - valid) * 1e300
            low = minimum(low, value + padding)
            high = maximum(high, value - padding)
            if watched:
                outer = value * load(slab, edge + n)
                edge_mass = edge_mass + outer
                edge_energy = edge_energy + outer * (load(slab, SPEED2 * slab_size + n) + square)
    store(extremes, 0, low)
    store(extremes, 8, high)
    smallest, largest = extremes[0], extremes[8]
    for lane in range(1, 8):
        smallest, largest = min(smallest, extremes[lane]), max(largest, extremes[8 + lane])
    extremes[0], extremes[1] = smallest, largest
    extremes[2], extremes[3] = total(edge_mass), total(edge_energy)


@kernel
def sweep(  # type: ignore[no-untyped-def]
    grid,
    space,
    model,
    second,
    dt,
    g,
    out,
    start,
    stage,
    new,
    growth,
    omega_end,
    depth,
    source,
    heating,
    diagnostics,
    sides,
    work,
):
    """One stage for all cells of a rank.

    The first stage takes g^n to g* = relax(g^n + dt L(g^n)); the second, from g*, to
    g^(n+1) = relax(1/2 g^n + 1/2 (g* + dt L(g*))), both with an implicit relaxation of the same depth (docs/method.md).

    Parameters
    ----------
    second : bool
        Which of the two stages. The second writes over g^n, cell by cell.
    g, out : flat arrays
        Ghosted blocks read and written.
    start, stage, new : Cells
        At t^n; at the beginning of this stage; receives this stage's result (interior of omega, carried, sums).
    growth, omega_end : (ny, nx) arrays
        ln(omega^(n+1)/omega^n)/dt and omega^(n+1), where the scaling does not follow from the kinetic moments.
    depth : (ny, nx) array
        Relaxation depth dt tau/eps averaged over the step; the first stage writes it, the second reads it. With a
        source it is that of the penalisation, given for both.
    source, heating : flat array, (ny, nx) array
        Rate of g by an operator that is taken explicitly, blocks without ghosts, and the rate of f's energy with it;
        None where there is none: what it needs is then not even compiled.
    diagnostics : (ny, nx, DIAGNOSTICS) array
        Receives the columns named at the top of this module.
    sides : tuple of four (n, 5) arrays
        Receive the rates of mass, momentum and energy through the outermost faces (x lower, x upper, y lower, y upper),
        counted along +x and +y, per area of face times 1/dx or 1/dy.
    """
    d, points, slab_size, block, weight = (
        grid.dimensions,
        grid.points,
        grid.slab_size,
        grid.block,
        grid.weight,
    )
    points_x = points[0]
    nx, ny, wx, wy = space.nx, space.ny, space.wx, space.wy
    row = (nx + 2 * wx) * block
    gx, gy = wx, wy
    omega = stage.omega
    west, south, result = work.west, work.south, work.result
    south_moments, rates, v, extremes = work.south_moments, work.rates, work.vectors, work.extremes
    west_moments, east_moments, north_moments = v[0], v[1], v[2]
    west_through, north_through, south_through, east_through = v[3], v[4], v[5], v[6]
    target, sums, m0, wanted, tensor, centre, fitted = v[7], v[8], v[9], v[10], v[11], v[12], v[13]
    factor_x, factor_slab = work.correction[0], work.correction[1]
    carries = model.kinetic or model.conservative
    watched = second or dt == 0.0
    for n in range(0, block, 8):
        store(west, n, splat(0.0))
    for n in range(0, nx * block, 8):
        store(south, n, splat(0.0))
    west_moments[:] = 0.0
    south_moments[:] = 0.0
    # ghost cells first, below and left of the others: the sweep needs the fluxes through their upper faces
    for j in range(0 if space.dimensions < 2 else -1, ny):
        for i in range(0 if space.dimensions < 1 else -1, nx):
            if i < 0 and j < 0:
                continue
            cell = (j + wy) * row + (i + wx) * block
            here = omega[j + gy, i + gx]
            omega_w, omega_e, omega_s, omega_n = (here, here), (here, here), (here, here), (here, here)
            across_x, across_y = space.dimensions >= 1 and j >= 0, space.dimensions == 2 and i >= 0
            if across_x:
                omega_e = face_omega(model.conservative, omega, j + gy, i + gx, 0, 1)
            if across_y:
                omega_n = face_omega(model.conservative, omega, j + gy, i + gx, 1, 0)
            upper_fluxes(
                g,
                cell,
                block if across_x else 0,
                row if across_y else 0,
                points_x,
                slab_size,
                grid.below,
                grid.x,
                grid.slab,
                (omega_e[0], omega_e[1], omega_n[0], omega_n[1]),
                space.per_dx if across_x else 0.0,
                space.per_dy if across_y else 0.0,
                west if j >= 0 else work.gaussian,
                south if i >= 0 else work.gaussian,
                max(i, 0) * block,
                work.faces,
                result,
                east_moments,
                north_moments,
            )
            if j < 0:
                for q in range(5):
                    south_moments[i, q] = north_moments[q]
                continue
            if i < 0:
                for q in range(5):
                    west_moments[q] = east_moments[q]
                continue
            if across_x:
                omega_w = face_omega(model.conservative, omega, j + gy, i + gx - 1, 0, 1)
            if across_y:
                omega_s = face_omega(model.conservative, omega, j + gy - 1, i + gx, 1, 0)
            through(west_moments, weight, west_through)
            through(east_moments, weight, east_through)
            through(south_moments[i], weight, south_through)
            through(north_moments, weight, north_through)
            for q in range(5):
                if i == 0:
                    sides[0][j, q] = west_through[q]
                if i == nx - 1:
                    sides[1][j, q] = east_through[q]
                if j == 0:
                    sides[2][i, q] = south_through[q]
                if j == ny - 1:
                    sides[3][i, q] = north_through[q]
                west_moments[q] = east_moments[q]
                south_moments[i, q] = north_moments[q]
                # from here on `east_through` holds the net rate of the cell
                east_through[q] = (west_through[q] - east_through[q]) + (south_through[q] - north_through[q])
            rate = east_through

            if source is not None:
                rate[4] += heating[j, i]

            # the state at the beginning of this stage, in f's units
            old = stage.carried[j, i]
            if carries:
                density, energy = old[0], old[4]
                ux, uy, uz = old[1] / density, old[2] / density, old[3] / density
            else:
                s = stage.sums[j, i]
                density = weight * s[0]
                ux, uy, uz = here * s[1] / s[0], here * s[2] / s[0], here * s[3] / s[0]
                energy = 0.5 * weight * here * here * (s[4] + s[7] + s[9])
            kinetic_energy = 0.5 * density * (ux * ux + uy * uy + uz * uz)
            thermal = energy - kinetic_energy
            status = HEALTHY
            if not (density > 0.0 and thermal > 0.0):
                diagnostics[j, i, STATUS] = NOT_POSITIVE
                continue
            temperature = 2.0 * thermal / (d * density)

            # cooling: one rate for drag and scaling, the mean over the step (ahead in stage one, behind in stage two)
            beta = 0.0
            if model.cooling > 0.0:
                frequency = model.cooling * density * math.sqrt(temperature)
                beta = frequency
                if dt > 0.0:
                    beta = (
                        -math.log(max(1.0 - frequency * dt, 1e-3)) / dt
                        if second
                        else math.log(1.0 + frequency * dt) / dt
                    )
            if model.kinetic:
                transported = 0.5 * (rate[4] / energy - rate[0] / density)
                total_rate = transported + beta * (kinetic_energy / energy)
            else:
                total_rate = growth[j, i] + beta
            rates[0] = total_rate
            for q in range(2):
                rates[1 + q] = (omega_e[q] - omega_w[q]) * space.per_dx
                rates[3 + q] = (omega_n[q] - omega_s[q]) * space.per_dy
            rates[5], rates[6], rates[7] = beta * ux / here, beta * uy / here, beta * uz / here
            rates[8], rates[9], rates[10] = grid.per_spacing[0], grid.per_spacing[1], grid.per_spacing[2]
            crossing = max(omega_w[0], omega_w[1], omega_e[0], omega_e[1]) * grid.half_width[0] * space.per_dx
            crossing += max(omega_s[0], omega_s[1], omega_n[0], omega_n[1]) * grid.half_width[1] * space.per_dy
            drifting = 0.0
            turning = abs(total_rate) + max(abs(rates[1]), abs(rates[2])) * grid.half_width[0]
            turning += max(abs(rates[3]), abs(rates[4])) * grid.half_width[1]
            for q in range(d):
                drifting += (turning * grid.half_width[q] + abs(rates[5 + q])) * grid.per_spacing[q]

            # transport and drift
            first = start.sums[j, i]
            z = depth[j, i] if second or source is not None else 0.0
            weight_old, weight_new = (0.5, 0.5 * (1.0 + z)) if second else (0.0, 1.0)
            weight_first, replaced = 0.5 * z, 0.0
            if source is not None:
                at = (j * nx + i) * block
                for n in range(0, block, 8):
                    store(result, n, load(result, n) + load(source, at + n))
            substeps = drift_substeps(dt, crossing, drifting, model.courant)
            if substeps == 0:
                scratch = work.scratch
                drift.apply(grid.stencil, g, cell, grid, rates, out, weight_old, weight_new, dt, scratch, result)
            else:
                share = 0.0
                if weight_first > 0.0 and second and model.collisions:
                    density_blend = blend(model.nu, d, first, first, first, 1.0, 1.0, 0.0, 1.0, centre, tensor)
                    answer = discrete_gaussian(density_blend, centre, tensor, grid, work.fit, work.gaussian, fitted)
                    if answer > REPLACED:
                        diagnostics[j, i, STATUS] = TOO_COLD_FOR_GRID if answer == TOO_COLD else NO_GAUSSIAN
                        continue
                    replaced = 1.0 if answer == REPLACED else 0.0
                    share = weight_first * density_blend / fitted[0]
                take_substeps(g, out, cell, grid, rates, second, weight_new, share, dt, substeps, work)
                weight_first = 0.0

            # the carried moments at the end of the stage
            dissipated = 0.0
            mismatch = 0.0
            omega_new = omega_end[j, i]
            if carries:
                u = new.carried[j, i]
                for q in range(5):
                    u[q] = old[q] + dt * rate[q]
                if second:
                    begin = start.carried[j, i]
                    before = begin[4] - 0.5 * (begin[1] ** 2 + begin[2] ** 2 + begin[3] ** 2) / begin[0]
                    dissipated = before - cooled(before, begin[0], d, model.cooling, dt)
                    for q in range(5):
                        u[q] = 0.5 * begin[q] + 0.5 * u[q]
                    u[4] -= 0.5 * dissipated
                    dissipated *= 0.5
                else:
                    if not u[0] > 0.0:
                        diagnostics[j, i, STATUS] = NOT_POSITIVE
                        continue
                    before = u[4] - 0.5 * (u[1] ** 2 + u[2] ** 2 + u[3] ** 2) / u[0]
                    if not before > 0.0:
                        diagnostics[j, i, STATUS] = NOT_POSITIVE
                        continue
                    dissipated = before - cooled(before, u[0], d, model.cooling, dt)
                    u[4] -= dissipated
                    dissipated *= 0.5
                if not (u[0] > 0.0 and u[4] > 0.5 * (u[1] ** 2 + u[2] ** 2 + u[3] ** 2) / u[0]):
                    diagnostics[j, i, STATUS] = NOT_POSITIVE
                    continue
                if model.kinetic:
                    omega_new = math.sqrt(2.0 * u[4] / (d * u[0]))
                wanted[0] = u[0] / weight
                for q in range(3):
                    wanted[1 + q] = u[1 + q] / (weight * omega_new)
                wanted[4] = u[4] / (weight * omega_new * omega_new)
            if not model.conservative:
                for k in range(points_x):
                    factor_x[k] = 1.0
                for n in range(0, slab_size, 8):
                    store(factor_slab, n, splat(1.0))
                for q in range(3):
                    target[q] = 0.0
                weighted_sums(
                    result,
                    target,
                    points_x,
                    slab_size,
                    grid.x,
                    grid.slab,
                    factor_x,
                    factor_slab,
                    work.correction[2],
                    sums,
                )
                if not carries:
                    before = cooled(thermal, density, d, model.cooling, -dt if second else dt)
                    dissipated = 0.5 * abs(thermal - before)
            cooling_rate = 2.0 * beta * thermal / energy
            if source is not None:
                dissipated = -0.5 * dt * heating[j, i]
                cooling_rate = abs(heating[j, i]) / energy
            for q in range(4):
                m0[q] = first[q]
            m0[4] = 0.5 * (first[4] + first[7] + first[9])
            if not model.conservative:
                wanted[4] = 0.5 * (sums[4] + sums[7] + sums[9])
                for q in range(4):
                    wanted[q] = sums[q]
                if second:
                    for q in range(5):
                        wanted[q] = (wanted[q] + weight_first * m0[q]) / (1.0 + z)
            density_new = wanted[0]
            if not density_new > 0.0:
                diagnostics[j, i, STATUS] = NOT_POSITIVE
                continue
            speed2 = (wanted[1] ** 2 + wanted[2] ** 2 + wanted[3] ** 2) / density_new**2
            temperature_new = (2.0 * wanted[4] / density_new - speed2) / d
            if not temperature_new > 0.0:
                diagnostics[j, i, STATUS] = NOT_POSITIVE
                continue
            if model.collisions and source is None and not second:
                z0 = relaxation_rate(model, density, temperature)
                z1 = relaxation_rate(model, density_new * weight, temperature_new * omega_new * omega_new)
                z = 0.5 * dt * (z0 + z1)
                depth[j, i] = z
            weight_last = 0.5 * z * z if second else z
            if not second:
                weight_first = 0.0
            whole = 1.0 + z + weight_last if second else 1.0 + z
            if model.conservative and source is None:
                for q in range(5):
                    target[q] = (whole - weight_last) * wanted[q] - weight_first * m0[q]
                mismatch = correct(result, target, d, points_x, slab_size, grid.x, grid.slab, work.correction, sums)
                if mismatch < 0.0:
                    diagnostics[j, i, STATUS] = NO_CORRECTION
                    continue
            share = weight_first + weight_last
            if model.collisions and share > 0.0:
                density_blend = blend(
                    model.nu,
                    d,
                    first,
                    sums,
                    wanted,
                    temperature_new,
                    weight_first,
                    weight_last,
                    whole,
                    centre,
                    tensor,
                )
                answer = discrete_gaussian(density_blend, centre, tensor, grid, work.fit, work.gaussian, fitted)
                # its mass to round-off, not only to Newton's tolerance
                share *= density_blend / fitted[0] if answer <= REPLACED else 0.0
                if answer == REPLACED:
                    replaced = 1.0
                elif answer == TOO_COLD:
                    status = TOO_COLD_FOR_GRID
                elif answer == FAILED:
                    status = NO_GAUSSIAN
            if source is not None:
                # the operator leaves g negative in places, far so where it is penalised
                if share > 0.0:
                    for n in range(0, block, 8):
                        store(result, n, load(result, n) + load(work.gaussian, n) * share)
                    for q in range(10):
                        sums[q] += fitted[q] * share
                    share = 0.0
                if model.conservative:
                    for q in range(3):
                        centre[q] = wanted[1 + q] / wanted[0]
                    answer = discrete_maxwellian(
                        wanted[0], centre, temperature_new, grid, work.fit, tensor, work.gaussian, fitted
                    )
                    for q in range(5):
                        target[q] = whole * wanted[q]
                    if answer <= REPLACED:
                        mismatch = add_correction(
                            result,
                            work.gaussian,
                            target,
                            d,
                            points_x,
                            slab_size,
                            grid.x,
                            grid.slab,
                            work.correction,
                            sums,
                        )
                    if answer > REPLACED or mismatch < 0.0:
                        diagnostics[j, i, STATUS] = NO_CORRECTION
                        continue
            done = new.sums[j, i]
            for q in range(10):
                done[q] = sums[q] / whole
                if share > 0.0:
                    done[q] += fitted[q] * (share / whole)
            mix(
                result,
                factor_x,
                factor_slab,
                1.0 / whole,
                work.gaussian,
                share / whole,
                points_x,
                slab_size,
                grid.x,
                grid.slab,
                out,
                cell,
                watched,
                extremes,
            )
            if watched:
                diagnostics[j, i, BOX_MASS] = extremes[2] / done[0]
                diagnostics[j, i, BOX_ENERGY] = extremes[3] / (done[4] + done[7] + done[9])
            # what is no number anywhere in g is none in its sums
            if not math.isfinite(done[0] + (done[4] + done[7] + done[9])):
                status = NOT_A_NUMBER
            new.omega[j + gy, i + gx] = omega_new
            diagnostics[j, i, SMALLEST] = extremes[0]
            diagnostics[j, i, LARGEST] = extremes[1]
            diagnostics[j, i, MISMATCH] = mismatch
            diagnostics[j, i, GAUSSIANS_REPLACED] = replaced
            diagnostics[j, i, TRANSPORT] = crossing
            diagnostics[j, i, DRIFT] = drifting
            diagnostics[j, i, DISSIPATED] = dissipated
            diagnostics[j, i, COOLING_RATE] = cooling_rate
            diagnostics[j, i, STATUS] = status
