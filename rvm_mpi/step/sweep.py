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

from rvm_mpi.collisions.es_bgk import EXACT, REPLACED, TOO_COLD, discrete_gaussian, discrete_maxwellian
from rvm_mpi.compiling.declare import kernel, part
from rvm_mpi.compiling.simd import load, maximum, minimum, splat, store, total
from rvm_mpi.grid.velocity import EDGE, SPEED2, VALID, VelocityGrid, Y
from rvm_mpi.kinetic import drift
from rvm_mpi.kinetic.conservation import SUMS, add_correction, correct, weighted_sums
from rvm_mpi.kinetic.transport import PIECE, upper_fluxes
from rvm_mpi.time_limits import FITS
from rvm_mpi.units import power as plain_power

#: columns of the diagnostics a stage leaves of each cell; the rates are sums of max|a|/h over the directions
SMALLEST, LARGEST, MISMATCH, GAUSSIANS_REPLACED, TRANSPORT, DRIFT, DISSIPATED, COOLING_RATE, STATUS = range(9)
#: shares of mass and energy of the outermost velocities, at the end of a step and of a stage of no length
BOX_MASS, BOX_ENERGY = 9, 10
DIAGNOSTICS = 11
#: rows of `Work.vectors`: moments of the fluxes through a cell's faces but the lower one in y, and the rates they make;
#: sums wanted of the block, sought by its correction, found in its result, and had before; mean, tensor and sums of a
#: Gaussian
WEST, EAST, NORTH, RATE, WANTED, TARGET, RESULT, BEFORE, CENTRE, TENSOR, FITTED = range(11)
#: what STATUS says
HEALTHY, TOO_COLD_FOR_GRID, NO_GAUSSIAN, NO_CORRECTION, NOT_POSITIVE, NOT_A_NUMBER = range(6)
#: greatest depth dt tau/eps of a relaxation. A deeper one differs from the limit eps -> 0 by less than 1/DEEPEST, but 1
#: beside its square is lost to rounding, and the explicit part with it
DEEPEST = 1e12


power = part(plain_power)


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


class Sides(NamedTuple):
    """Rates of mass, momentum and energy through the outermost faces: x lower, x upper, y lower, y upper.

    Each an array (n, 5), counted along +x and +y, per area of face times 1/dx or 1/dy. `through` is what a stage finds
    and leaves; `beyond` is the part of it that no ghost cell's g says (`walls.py`), zero at sides between ranks.
    """

    through: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    beyond: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

    @classmethod
    def create(cls, nx: int, ny: int) -> Sides:
        """Zeros for the sides of nx x ny cells."""
        x, y = np.zeros((2, 2, ny, 5)), np.zeros((2, 2, nx, 5))
        return cls((x[0, 0], x[0, 1], y[0, 0], y[0, 1]), (x[1, 0], x[1, 1], y[1, 0], y[1, 1]))


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
        from rvm_mpi.grid.domain import aligned

        nvx = grid.points[0]
        guarded = (grid.block + 2 * drift.reach.py_func(grid.points[2], grid.slab_size),)
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
            vectors=np.zeros((11, SUMS)),
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
    return model.relaxation * power(density, model.density_power) * power(temperature, model.temperature_power)


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
        weight = substeps / (substeps + 1) if last else 1.0
        weight_start = 1.0 - weight  # one together, to the last bit: no mass is lost
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


@part
def cross(grid, space, model, g, cell, omega, j, i, work):  # type: ignore[no-untyped-def]
    """The fluxes through the upper faces of cell (j, i), a ghost cell where an index is negative, and their moments.

    A ghost cell's moments are left where the cell beyond the face looks for those of its lower face.
    """
    y, x = j + space.wy, i + space.wx
    omega_e, omega_n = (omega[y, x], omega[y, x]), (omega[y, x], omega[y, x])
    along_x, along_y, per_dx, per_dy = 0, 0, 0.0, 0.0
    if space.dimensions >= 1 and j >= 0:
        omega_e = face_omega(model.conservative, omega, y, x, 0, 1)
        along_x, per_dx = grid.block, space.per_dx
    if space.dimensions == 2 and i >= 0:
        omega_n = face_omega(model.conservative, omega, y, x, 1, 0)
        along_y, per_dy = (space.nx + 2 * space.wx) * grid.block, space.per_dy
    west, east, north = work.vectors[WEST], work.vectors[EAST], work.vectors[NORTH]
    upper_fluxes(
        g,
        cell,
        along_x,
        along_y,
        grid.points[0],
        grid.slab_size,
        grid.below,
        grid.x,
        grid.slab,
        (omega_e[0], omega_e[1], omega_n[0], omega_n[1]),
        per_dx,
        per_dy,
        work.west if j >= 0 else work.gaussian,
        work.south if i >= 0 else work.gaussian,
        max(i, 0) * grid.block,
        work.faces,
        work.result,
        east,
        north,
    )
    for q in range(5):
        if j < 0:
            work.south_moments[i, q] = north[q]
        elif i < 0:
            west[q] = east[q]


@part
def net_rates(weight, space, sides, j, i, v, south_moments):  # type: ignore[no-untyped-def]
    """Rates of a cell's mass, momentum and energy by the fluxes through its faces, from their moments (`transport.py`).

    The moments of the upper faces become those of the next cells' lower ones.
    """
    south = south_moments[i]
    west, east, north, rate = v[WEST], v[EAST], v[NORTH], v[RATE]
    for q in range(5):
        unit = weight if q < 4 else 0.5 * weight
        lower_x, upper_x, lower_y, upper_y = unit * west[q], unit * east[q], unit * south[q], unit * north[q]
        if i == 0:
            lower_x += sides.beyond[0][j, q]
            sides.through[0][j, q] = lower_x
        if i == space.nx - 1:
            upper_x += sides.beyond[1][j, q]
            sides.through[1][j, q] = upper_x
        if j == 0:
            lower_y += sides.beyond[2][i, q]
            sides.through[2][i, q] = lower_y
        if j == space.ny - 1:
            upper_y += sides.beyond[3][i, q]
            sides.through[3][i, q] = upper_y
        west[q], south[q] = east[q], north[q]
        rate[q] = (lower_x - upper_x) + (lower_y - upper_y)


@part
def state_of(grid, model, carried, sums, omega):  # type: ignore[no-untyped-def]
    """Density, velocity (three numbers) and energy of f in a cell: as carried, else from the sums of g."""
    if model.kinetic or model.conservative:
        rho = carried[0]
        return rho, carried[1] / rho, carried[2] / rho, carried[3] / rho, carried[4]
    weight, rho = grid.weight, sums[0]
    energy = 0.5 * weight * omega * omega * (sums[4] + sums[7] + sums[9])
    return weight * rho, omega * sums[1] / rho, omega * sums[2] / rho, omega * sums[3] / rho, energy


@part
def mean_drag(model, second, density, temperature, dt):  # type: ignore[no-untyped-def]
    """The rate of the drag, the mean over the step: ahead in stage one, behind in stage two."""
    if not model.cooling > 0.0:
        return 0.0
    frequency = model.cooling * density * math.sqrt(temperature)
    if not dt > 0.0:
        return frequency
    return -math.log(max(1.0 - frequency * dt, 1e-3)) / dt if second else math.log(1.0 + frequency * dt) / dt


@part
def omega_across(upwind, omega, y, x, down, right):  # type: ignore[no-untyped-def]
    """omega at a cell's lower face and at its upper one along (down, right), each as `face_omega` has it."""
    if down + right == 0:
        here = omega[y, x]
        return here, here, here, here
    lower = face_omega(upwind, omega, y - down, x - right, down, right)
    upper = face_omega(upwind, omega, y, x, down, right)
    return lower[0], lower[1], upper[0], upper[1]


@part
def drift_rates(grid, space, model, omega, j, i, rates):  # type: ignore[no-untyped-def]
    """Complete a cell's rates for `drift.py`, the first and the pushes given, by those that grad omega makes.

    Returns the sums of max|a|/h over the directions of space and over those of velocity.
    """
    y, x, upwind = j + space.wy, i + space.wx, model.conservative
    w0, w1, e0, e1 = omega_across(upwind, omega, y, x, 0, 1 if space.dimensions >= 1 else 0)
    s0, s1, n0, n1 = omega_across(upwind, omega, y, x, 1 if space.dimensions == 2 else 0, 0)
    rates[1], rates[2] = (e0 - w0) * space.per_dx, (e1 - w1) * space.per_dx
    rates[3], rates[4] = (n0 - s0) * space.per_dy, (n1 - s1) * space.per_dy
    half_width, per_spacing = grid.half_width, grid.per_spacing
    crossing = max(w0, w1, e0, e1) * half_width[0] * space.per_dx
    crossing += max(s0, s1, n0, n1) * half_width[1] * space.per_dy
    turning = drift.fastest_turning(rates, half_width)
    drifting = 0.0
    for q in range(3):
        rates[8 + q] = per_spacing[q]
        if q < grid.dimensions:
            drifting += (turning * half_width[q] + abs(rates[5 + q])) * per_spacing[q]
    return crossing, drifting


@part
def explicit_part(grid, model, second, dt, g, out, cell, first, z, source, at, substeps, work):  # type: ignore[no-untyped-def]
    """The explicit part of a stage: `work.result` from the change by transport that it holds.

    Returns what `discrete_gaussian` says of the Gaussian that a drift in substeps takes along, else EXACT, and the
    weight that the first Gaussian has yet to be added with.
    """
    result = work.result
    weight_first = 0.5 * z if second else 0.0
    weight_old, weight_new = (0.5, 0.5 * (1.0 + z)) if second else (0.0, 1.0)
    if source is not None:
        for n in range(0, grid.block, 8):
            store(result, n, load(result, n) + load(source, at + n))
    if substeps == 0:
        drift.apply(
            grid.stencil, g, cell, grid, work.rates, out, weight_old, weight_new, dt, work.scratch, result
        )
        return EXACT, weight_first
    share, answer = 0.0, EXACT
    if weight_first > 0.0 and model.collisions:
        centre, tensor, fitted = work.vectors[CENTRE], work.vectors[TENSOR], work.vectors[FITTED]
        density = blend(model.nu, grid.dimensions, first, first, first, 1.0, 1.0, 0.0, 1.0, centre, tensor)
        answer = discrete_gaussian(density, centre, tensor, grid, work.fit, work.gaussian, fitted)
        if answer > REPLACED:
            return answer, 0.0
        share = weight_first * density / fitted[0]
    take_substeps(g, out, cell, grid, work.rates, second, weight_new, share, dt, substeps, work)
    return answer, 0.0


@part
def thermal_energy(carried):  # type: ignore[no-untyped-def]
    """Energy less that of the mean velocity, from rho, rho u, E."""
    return carried[4] - 0.5 * (carried[1] ** 2 + carried[2] ** 2 + carried[3] ** 2) / carried[0]


@part
def carry(d, cooling, second, dt, begin, old, rate, new):  # type: ignore[no-untyped-def]
    """The carried moments at the end of a stage, from those at t^n and at the stage's beginning.

    Returns whether density and thermal energy are positive, and the stage's share of the energy that collisions took.
    """
    for q in range(5):
        new[q] = old[q] + dt * rate[q]
    if second:
        before = thermal_energy(begin)
        dissipated = 0.5 * (before - cooled(before, begin[0], d, cooling, dt))
        for q in range(5):
            new[q] = 0.5 * begin[q] + 0.5 * new[q]
        new[4] -= dissipated
    else:
        before = thermal_energy(new)
        if not (new[0] > 0.0 and before > 0.0):
            return False, 0.0
        dissipated = 0.5 * (before - cooled(before, new[0], d, cooling, dt))
        new[4] -= 2.0 * dissipated
    return new[0] > 0.0 and thermal_energy(new) > 0.0, dissipated


@part
def measure(grid, result, target, correction, sums):  # type: ignore[no-untyped-def]
    """Sums of a block as it is, with the correction's factor left at one."""
    factor_x, factor_slab = correction[0], correction[1]
    for k in range(grid.points[0]):
        factor_x[k] = 1.0
    for n in range(0, grid.slab_size, 8):
        store(factor_slab, n, splat(1.0))
    for q in range(3):
        target[q] = 0.0
    weighted_sums(
        result, target, grid.points[0], grid.slab_size, grid.x, grid.slab, factor_x, factor_slab, correction[2], sums
    )


@part
def sums_to_have(grid, model, second, z, weight_first, carried, omega, first, work):  # type: ignore[no-untyped-def]
    """Sums 1, xi, |xi|^2/2 at the end of a stage: those of the carried moments, or of the block's relaxed result."""
    v = work.vectors
    wanted, sums, before = v[WANTED], v[RESULT], v[BEFORE]
    for q in range(4):
        before[q] = first[q]
    before[4] = 0.5 * (first[4] + first[7] + first[9])
    if model.conservative:
        weight = grid.weight
        wanted[0] = carried[0] / weight
        for q in range(1, 4):
            wanted[q] = carried[q] / (weight * omega)
        wanted[4] = carried[4] / (weight * omega * omega)
        return
    measure(grid, work.result, v[TARGET], work.correction, sums)
    for q in range(4):
        wanted[q] = sums[q]
    wanted[4] = 0.5 * (sums[4] + sums[7] + sums[9])
    if second:
        for q in range(5):
            wanted[q] = (wanted[q] + weight_first * before[q]) / (1.0 + z)


@part
def relax(grid, model, weight_first, weight_last, whole, temperature, first, source, work):  # type: ignore[no-untyped-def]
    """Correct `work.result` to its moments, and find the Gaussian that it is relaxed to, in `work.gaussian`.

    Returns the mismatch removed, -1 where that failed, what `discrete_gaussian` says, and the Gaussian's share.
    """
    v = work.vectors
    wanted, sums, centre, tensor, fitted = v[WANTED], v[RESULT], v[CENTRE], v[TENSOR], v[FITTED]
    mismatch, answer, share = 0.0, EXACT, weight_first + weight_last
    if model.conservative and source is None:
        target, before = v[TARGET], v[BEFORE]
        for q in range(5):
            target[q] = (whole - weight_last) * wanted[q] - weight_first * before[q]
        mismatch = correct(
            work.result,
            target,
            grid.dimensions,
            grid.points[0],
            grid.slab_size,
            grid.x,
            grid.slab,
            work.correction,
            sums,
        )
        if mismatch < 0.0:
            return mismatch, answer, 0.0
    if model.collisions and share > 0.0:
        density = blend(
            model.nu,
            grid.dimensions,
            first,
            sums,
            wanted,
            temperature,
            weight_first,
            weight_last,
            whole,
            centre,
            tensor,
        )
        answer = discrete_gaussian(density, centre, tensor, grid, work.fit, work.gaussian, fitted)
        # its mass to round-off, not only to Newton's tolerance
        share *= density / fitted[0] if answer <= REPLACED else 0.0
    return mismatch, answer, share


@part
def correct_signed(grid, model, share, whole, temperature, work):  # type: ignore[no-untyped-def]
    """The correction where an operator leaves g negative in places, far so where it is penalised.

    Its Gaussian is mixed in before. Returns the mismatch removed, -1 where that failed.
    """
    v = work.vectors
    wanted, target, sums, centre, fitted = v[WANTED], v[TARGET], v[RESULT], v[CENTRE], v[FITTED]
    if share > 0.0:
        for n in range(0, grid.block, 8):
            store(work.result, n, load(work.result, n) + load(work.gaussian, n) * share)
        for q in range(10):
            sums[q] += fitted[q] * share
    if not model.conservative:
        return 0.0
    for q in range(3):
        centre[q] = wanted[1 + q] / wanted[0]
    answer = discrete_maxwellian(wanted[0], centre, temperature, grid, work.fit, v[TENSOR], work.gaussian, fitted)
    if answer > REPLACED:
        return -1.0
    for q in range(5):
        target[q] = whole * wanted[q]
    return add_correction(
        work.result,
        work.gaussian,
        target,
        grid.dimensions,
        grid.points[0],
        grid.slab_size,
        grid.x,
        grid.slab,
        work.correction,
        sums,
    )


@part
def finish(grid, watched, share, whole, out, cell, done, work, report):  # type: ignore[no-untyped-def]
    """Write a cell's block and its sums (10), and report on them; False where they are no numbers."""
    sums, fitted, extremes = work.vectors[RESULT], work.vectors[FITTED], work.extremes
    for q in range(10):
        done[q] = sums[q] / whole
        if share > 0.0:
            done[q] += fitted[q] * (share / whole)
    mix(
        work.result,
        work.correction[0],
        work.correction[1],
        1.0 / whole,
        work.gaussian,
        share / whole,
        grid.points[0],
        grid.slab_size,
        grid.x,
        grid.slab,
        out,
        cell,
        watched,
        extremes,
    )
    report[SMALLEST], report[LARGEST] = extremes[0], extremes[1]
    trace = done[4] + done[7] + done[9]
    if watched:
        report[BOX_MASS], report[BOX_ENERGY] = extremes[2] / done[0], extremes[3] / trace
    # what is no number anywhere in g is none in its sums
    return math.isfinite(done[0] + trace)


@part
def problem(answer):  # type: ignore[no-untyped-def]
    """A cell's STATUS from what `discrete_gaussian` says."""
    if answer <= REPLACED:
        return HEALTHY
    return TOO_COLD_FOR_GRID if answer == TOO_COLD else NO_GAUSSIAN


@part
def advance(  # type: ignore[no-untyped-def]
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
    report,
    j,
    i,
    work,
):
    """Take cell (j, i) through a stage, the changes by transport known; returns its STATUS."""
    d, rate, wanted = grid.dimensions, work.vectors[RATE], work.vectors[WANTED]
    cell = (j + space.wy) * (space.nx + 2 * space.wx) * grid.block + (i + space.wx) * grid.block
    if source is not None:
        rate[4] += heating[j, i]
    first, old, here = start.sums[j, i], stage.carried[j, i], stage.omega[j + space.wy, i + space.wx]
    density, ux, uy, uz, energy = state_of(grid, model, old, stage.sums[j, i], here)
    kinetic_energy = 0.5 * density * (ux * ux + uy * uy + uz * uz)
    thermal = energy - kinetic_energy
    if not (density > 0.0 and thermal > 0.0):
        return NOT_POSITIVE
    temperature = 2.0 * thermal / (d * density)

    # cooling: one rate for drag and scaling
    beta, rates = mean_drag(model, second, density, temperature, dt), work.rates
    if model.kinetic:
        rates[0] = 0.5 * (rate[4] / energy - rate[0] / density) + beta * (kinetic_energy / energy)
    else:
        rates[0] = growth[j, i] + beta
    rates[5], rates[6], rates[7] = beta * ux / here, beta * uy / here, beta * uz / here
    crossing, drifting = drift_rates(grid, space, model, stage.omega, j, i, rates)
    report[TRANSPORT], report[DRIFT] = crossing, drifting

    z = depth[j, i] if second or source is not None else 0.0
    substeps, at = drift_substeps(dt, crossing, drifting, model.courant), (j * space.nx + i) * grid.block
    replaced, weight_first = explicit_part(
        grid, model, second, dt, g, out, cell, first, z, source, at, substeps, work
    )
    if replaced > REPLACED:
        return problem(replaced)

    omega_new, carried = omega_end[j, i], new.carried[j, i]
    if model.kinetic or model.conservative:
        positive, dissipated = carry(d, model.cooling, second, dt, start.carried[j, i], old, rate, carried)
        if not positive:
            return NOT_POSITIVE
        if model.kinetic:
            omega_new = math.sqrt(2.0 * carried[4] / (d * carried[0]))
    else:
        dissipated = 0.5 * abs(thermal - cooled(thermal, density, d, model.cooling, -dt if second else dt))
    report[DISSIPATED], report[COOLING_RATE] = dissipated, 2.0 * beta * thermal / energy
    if source is not None:
        report[DISSIPATED], report[COOLING_RATE] = -0.5 * dt * heating[j, i], abs(heating[j, i]) / energy
    sums_to_have(grid, model, second, z, weight_first, carried, omega_new, first, work)
    speed2 = (wanted[1] ** 2 + wanted[2] ** 2 + wanted[3] ** 2) / wanted[0] ** 2
    temperature_new = (2.0 * wanted[4] / wanted[0] - speed2) / d
    if not (wanted[0] > 0.0 and temperature_new > 0.0):
        return NOT_POSITIVE

    if model.collisions and source is None and not second:
        before = relaxation_rate(model, density, temperature)
        after = relaxation_rate(model, wanted[0] * grid.weight, temperature_new * omega_new * omega_new)
        z = 0.5 * dt * (before + after)
        if z > DEEPEST:
            z = DEEPEST
        depth[j, i] = z
    weight_last = 0.5 * z * z if second else z
    whole = 1.0 + z + weight_last if second else 1.0 + z
    mismatch, answer, share = relax(
        grid, model, weight_first, weight_last, whole, temperature_new, first, source, work
    )
    if source is not None and mismatch >= 0.0:
        mismatch = correct_signed(grid, model, share, whole, temperature_new, work)
        share = 0.0
    if mismatch < 0.0:
        return NO_CORRECTION
    report[MISMATCH] = mismatch
    report[GAUSSIANS_REPLACED] = 1.0 if replaced == REPLACED or answer == REPLACED else 0.0
    new.omega[j + space.wy, i + space.wx] = omega_new
    watched = second or dt == 0.0
    numbers = finish(grid, watched, share, whole, out, cell, new.sums[j, i], work, report)
    return problem(answer) if numbers else NOT_A_NUMBER


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
    sides : Sides
        Its `through` receives the rates through the outermost faces, `beyond` among them.
    """
    for n in range(0, grid.block, 8):
        store(work.west, n, splat(0.0))
    for n in range(0, space.nx * grid.block, 8):
        store(work.south, n, splat(0.0))
    work.vectors[WEST, :] = 0.0
    work.south_moments[:] = 0.0
    # ghost cells first, below and left of the others: the sweep needs the fluxes through their upper faces
    for j in range(0 if space.dimensions < 2 else -1, space.ny):
        for i in range(0 if space.dimensions < 1 else -1, space.nx):
            if i < 0 and j < 0:
                continue
            cell = (j + space.wy) * (space.nx + 2 * space.wx) * grid.block + (i + space.wx) * grid.block
            cross(grid, space, model, g, cell, stage.omega, j, i, work)
            if i < 0 or j < 0:
                continue
            net_rates(grid.weight, space, sides, j, i, work.vectors, work.south_moments)
            report = diagnostics[j, i]
            report[STATUS] = advance(
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
                report,
                j,
                i,
                work,
            )
