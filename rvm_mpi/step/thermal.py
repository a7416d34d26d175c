"""The thermal scaling: a cell's frame is its own mean velocity u and thermal speed omega = sqrt(T), v = u + omega xi.

What crosses a face carries the frame of the side it comes from, each reconstructed at the face; how a cell's frame
turns is taken from what its carried moments do in the stage, the share of dissipation left out: the drag of a granular
gas cancels that exactly.
"""

from __future__ import annotations

import math

from rvm_mpi.compiling.declare import part
from rvm_mpi.kinetic.drift import Drift
from rvm_mpi.kinetic.drift_speed import fastest_thermal
from rvm_mpi.kinetic.limiter import face_number
from rvm_mpi.step.carried import cooled, thermal_energy

#: the most that u may change from a cell's middle to its face, in units of omega: with more a cell can be left with
#: less energy than its mean motion has
STEEPEST = 0.5


@part
def towards(omega, mean, here, behind, ahead):  # type: ignore[no-untyped-def]
    """The frame (u, omega) on the face between a cell and the one ahead, as this cell's gas has it; places (y, x)."""
    y, x = here
    b = omega[y, x]
    w = face_number(b, b - omega[behind], omega[ahead] - b, 0.0)
    most = STEEPEST * b
    u0, u1, u2 = mean[y, x, 0], mean[y, x, 1], mean[y, x, 2]
    behind_u, ahead_u = mean[behind], mean[ahead]
    s0 = face_number(u0, u0 - behind_u[0], ahead_u[0] - u0, 0.0) - u0
    s1 = face_number(u1, u1 - behind_u[1], ahead_u[1] - u1, 0.0) - u1
    s2 = face_number(u2, u2 - behind_u[2], ahead_u[2] - u2, 0.0) - u2
    return (
        u0 + max(min(s0, most), -most),
        u1 + max(min(s1, most), -most),
        u2 + max(min(s2, most), -most),
        w,
    )


@part
def plain(omega, mean, here):  # type: ignore[no-untyped-def]
    """A cell's own frame."""
    u = mean[here]
    return u[0], u[1], u[2], omega[here]


@part
def face_frames(space, cells, y, x, down, right):  # type: ignore[no-untyped-def]
    """Frames on the upper face of cell (y, x) along (down, right): of the gas below it and of the gas above it.

    On a physical side that is no mirror neither is reconstructed: the gas inside leaves in its own frame, and what
    enters has that of the ghost cell (`walls_thermal.py`).
    """
    omega, mean = cells.omega, cells.mean
    if down + right == 0:
        own = plain(omega, mean, (y, x))
        return own, own
    before, here, there, after = (y - down, x - right), (y, x), (y + down, x + right), (y + 2 * down, x + 2 * right)
    if is_side(space, y, x, down):
        return plain(omega, mean, here), plain(omega, mean, there)
    return towards(omega, mean, here, before, there), towards(omega, mean, there, after, here)


@part
def is_side(space, y, x, down):  # type: ignore[no-untyped-def]
    """Whether the upper face of cell (y, x) along y (down = 1) or x (0) is a physical side that is no mirror."""
    lower_x, upper_x, lower_y, upper_y = space.stops
    if down == 1:
        return (lower_y and y == space.wy - 1) or (upper_y and y == space.wy + space.ny - 1)
    return (lower_x and x == space.wx - 1) or (upper_x and x == space.wx + space.nx - 1)


@part
def logarithmic_mean(a, b):  # type: ignore[no-untyped-def]
    """(b - a)/ln(b/a), and ln(b/a)."""
    change = math.log(b / a)
    return (a * (1.0 + 0.5 * change) if abs(change) < 1e-5 else (b - a) / change), change


@part
def speed_of(thermal, density, d):  # type: ignore[no-untyped-def]
    """omega from the thermal energy."""
    return math.sqrt(2.0 * thermal / (d * density))


@part
def rates_now(d, begin, rate):  # type: ignore[no-untyped-def]
    """Rates of the frame by the rates of the carried moments: d_t u/omega (three), d_t ln omega; and omega."""
    density = begin[0]
    u0, u1, u2 = begin[1] / density, begin[2] / density, begin[3] / density
    thermal = thermal_energy(begin)
    omega = speed_of(thermal, density, d)
    gain = rate[4] - (u0 * rate[1] + u1 * rate[2] + u2 * rate[3]) + 0.5 * (u0 * u0 + u1 * u1 + u2 * u2) * rate[0]
    per = 1.0 / (density * omega)
    return (
        (rate[1] - u0 * rate[0]) * per,
        (rate[2] - u1 * rate[0]) * per,
        (rate[3] - u2 * rate[0]) * per,
        0.5 * (gain / thermal - rate[0] / density),
        omega,
    )


@part
def rates_over(dt, before, after, warm, d):  # type: ignore[no-untyped-def]
    """Rates of a frame from the change of the carried moments over dt; warm: the thermal energy at its end, uncooled.

    d_t u/omega (three), d_t ln omega, and omega's mean on the way.
    """
    first = speed_of(thermal_energy(before), before[0], d)
    mean, change = logarithmic_mean(first, speed_of(warm, after[0], d))
    per = 1.0 / (dt * mean)
    return (
        (after[1] / after[0] - before[1] / before[0]) * per,
        (after[2] / after[0] - before[2] / before[0]) * per,
        (after[3] / after[0] - before[3] / before[0]) * per,
        change / dt,
        mean,
    )


@part
def frame_rates(model, d, stage, dt, fields, cell, rate, taken):  # type: ignore[no-untyped-def]
    """How a cell's frame turns in a stage: d_t u/omega (three numbers), d_t ln omega, and the omega that belongs to it.

    The actual change over a first stage. In the last one the whole step's change less what the stages before made of
    it, so that together they turn the frame by as much as it turns. Dissipation is left out.

    Parameters
    ----------
    rate : (5,) array
        Of the carried moments, by transport.
    taken : float
        Thermal energy that dissipation took in this stage.
    """
    begin, start, new = fields.begin.carried[cell.j, cell.i], fields.start.carried[cell.j, cell.i], fields.new.carried
    turned, after = fields.turned[cell.j, cell.i], new[cell.j, cell.i]
    if not dt > 0.0:
        return rates_now(d, begin, rate)
    warm, share = thermal_energy(after) + taken, stage.reach * (1.0 - stage.old)
    if stage.number == 0 or not stage.final:
        found = rates_over(dt, begin, after, warm, d)
        for q in range(4):
            turned[q] = share * found[q]
        return found
    # the cooling's share in the whole change: the mean of what it is from either end of the step
    cold, before = 1.0, thermal_energy(start)
    if model.cooling > 0.0:
        last = thermal_energy(begin)
        forwards = cooled(before, start[0], d, model.cooling, dt) / before
        backwards = last / cooled(last, begin[0], d, model.cooling, -stage.time * dt)
        cold = math.sqrt(forwards * backwards)
    whole = rates_over(dt, start, after, thermal_energy(after) / cold, d)
    # u, which cooling leaves alone, is measured in the thermal speed that there was
    cooling = rates_over(dt, start, after, thermal_energy(after), d)
    return (
        (cooling[0] - turned[0]) / share,
        (cooling[1] - turned[1]) / share,
        (cooling[2] - turned[2]) / share,
        (whole[3] - turned[3]) / share,
        whole[4] * math.sqrt(cold),
    )


@part
def across(space, cells, y, x, down, right):  # type: ignore[no-untyped-def]
    """Change of the frame across a cell along (down, right), for what goes up and for what goes down; largest speed."""
    lower = face_frames(space, cells, y - down, x - right, down, right)
    upper = face_frames(space, cells, y, x, down, right)
    (a, b), (c, e) = lower, upper
    rising = (c[0] - a[0], c[1] - a[1], c[2] - a[2], c[3] - a[3])
    falling = (e[0] - b[0], e[1] - b[1], e[2] - b[2], e[3] - b[3])
    along = 1 if down == 1 else 0
    fastest = max(abs(a[along]), abs(b[along]), abs(c[along]), abs(e[along]))
    return rising, falling, fastest, max(a[3], b[3], c[3], e[3])


@part
def thermal_drift(grid, space, cells, cell, turning):  # type: ignore[no-untyped-def]
    """A cell's drift in the thermal scaling, and how fast it and transport are.

    Parameters
    ----------
    cells : Cells
        Of the stage's beginning.
    cell : Here
    turning : tuple
        As `frame_rates` returns it.

    Returns
    -------
    Drift, float, float
        The drift; sums of max|a|/h over the directions of space and over those of velocity.
    """
    y, x, half_width = cell.y, cell.x, grid.half_width
    omega, u = cells.omega[y, x], cells.mean[y, x]
    a0, a1, a2, own, scale = turning
    none = (0.0, 0.0, 0.0, 0.0)
    up_x, down_x, up_y, down_y, crossing = none, none, none, none, 0.0
    if space.dimensions >= 1:
        up_x, down_x, fastest, widest = across(space, cells, y, x, 0, 1)
        crossing += (fastest + widest * half_width[0]) * space.per_dx
    if space.dimensions == 2:
        up_y, down_y, fastest, widest = across(space, cells, y, x, 1, 0)
        crossing += (fastest + widest * half_width[1]) * space.per_dy
    # v . grad w/omega, with v = omega (xi + flow)
    px, py = space.per_dx * (omega / scale), space.per_dy * (omega / scale)
    rises = (up_x[3] * px, down_x[3] * px, up_y[3] * py, down_y[3] * py)
    shears = (
        (up_x[0] * px, up_x[1] * px, up_x[2] * px),
        (down_x[0] * px, down_x[1] * px, down_x[2] * px),
        (up_y[0] * py, up_y[1] * py, up_y[2] * py),
        (down_y[0] * py, down_y[1] * py, down_y[2] * py),
    )
    push, flow = (-a0, -a1, -a2), (u[0] / omega, u[1] / omega)
    fastest_of = fastest_thermal(grid, own, rises, push, flow, shears)
    drift = Drift(
        own=own,
        rising_x=rises[0],
        falling_x=rises[1],
        rising_y=rises[2],
        falling_y=rises[3],
        push=push,
        centre=(0.0, 0.0, 0.0),
        temperature=1.0,
        flow=flow,
        shears=shears,
        fastest=fastest_of,
    )
    return drift, crossing, fastest_of[0] + fastest_of[1] + fastest_of[2]
