"""The moments that are carried beside g, rho, rho u and E of f: their rates by the fluxes, and their cooling."""

from __future__ import annotations

import math

from rvm_mpi.compiling.declare import part


@part
def net_rates(grid, space, sides, cell, moments):  # type: ignore[no-untyped-def]
    """Rates of a cell's mass, momentum and energy by the fluxes through its faces, from their moments (`transport.py`).

    The moments of the upper faces become those of the next cells' lower ones.
    """
    j, i = cell.j, cell.i
    south, west, east, north = moments.south[i], moments.west, moments.east, moments.north
    for q in range(5):
        unit = grid.weight if q < 4 else 0.5 * grid.weight
        lower_x, upper_x, lower_y, upper_y = unit * west[q], unit * east[q], unit * south[q], unit * north[q]
        if i == 0:
            lower_x += sides.beyond_x[0, j, q]
            sides.through_x[0, j, q] = lower_x
        if i == space.nx - 1:
            upper_x += sides.beyond_x[1, j, q]
            sides.through_x[1, j, q] = upper_x
        if j == 0:
            lower_y += sides.beyond_y[0, i, q]
            sides.through_y[0, i, q] = lower_y
        if j == space.ny - 1:
            upper_y += sides.beyond_y[1, i, q]
            sides.through_y[1, i, q] = upper_y
        west[q], south[q] = east[q], north[q]
        moments.rate[q] = (lower_x - upper_x) + (lower_y - upper_y)


@part
def state_of(grid, model, carried, sums, omega):  # type: ignore[no-untyped-def]
    """Density, velocity (three numbers) and energy of f in a cell: as carried, else from the sums of g."""
    if model.carried:
        rho = carried[0]
        return rho, carried[1] / rho, carried[2] / rho, carried[3] / rho, carried[4]
    weight, rho = grid.weight, sums[0]
    energy = 0.5 * weight * omega * omega * (sums[4] + sums[7] + sums[9])
    return weight * rho, omega * sums[1] / rho, omega * sums[2] / rho, omega * sums[3] / rho, energy


@part
def thermal_energy(carried):  # type: ignore[no-untyped-def]
    """Energy less that of the mean velocity, from rho, rho u, E."""
    return carried[4] - 0.5 * (carried[1] ** 2 + carried[2] ** 2 + carried[3] ** 2) / carried[0]


@part
def cooled(thermal, density, d, cooling, dt):  # type: ignore[no-untyped-def]
    """Thermal energy d rho T/2 after dt of dT/dt = -2 cooling rho T^(3/2), exactly (Haff), forwards or backwards."""
    root = math.sqrt(2.0 * thermal / (d * density))
    return thermal / (1.0 + cooling * density * root * dt) ** 2


@part
def mean_drag(cooling, time, density, temperature, dt):  # type: ignore[no-untyped-def]
    """The rate of the drag, -d ln sqrt(T)/dt, its mean over the step, from the state at the part `time` of it."""
    if not cooling > 0.0:
        return 0.0
    frequency = cooling * density * math.sqrt(temperature)
    if not dt > 0.0:
        return frequency
    behind = max(1.0 - time * frequency * dt, 1e-3)
    return math.log((1.0 + (1.0 - time) * frequency * dt) / behind) / dt


@part
def step_cooling(thermal, density, d, cooling, time, dt):  # type: ignore[no-untyped-def]
    """Thermal energy that cooling takes in a whole step, from that at the part `time` of it."""
    begin = thermal if time == 0.0 else cooled(thermal, density, d, cooling, -time * dt)
    end = thermal if time == 1.0 else cooled(thermal, density, d, cooling, (1.0 - time) * dt)
    return abs(begin - end)


@part
def carry(d, cooling, stage, dt, start, begin, rate, new):  # type: ignore[no-untyped-def]
    """The carried moments at the end of a stage, from those at t^n and at the stage's beginning.

    Returns whether density and thermal energy are positive, and the energy that collisions took.
    """
    for q in range(5):
        new[q] = stage.old * start[q] + (1.0 - stage.old) * (begin[q] + dt * rate[q])
    taken = 0.0
    if stage.cooled_before > 0.0:
        before = thermal_energy(start)
        taken += stage.cooled_before * (before - cooled(before, start[0], d, cooling, dt))
    if stage.cooled_after > 0.0:
        before = thermal_energy(new)
        if not (new[0] > 0.0 and before > 0.0):
            return False, 0.0
        taken += stage.cooled_after * (before - cooled(before, new[0], d, cooling, dt))
    new[4] -= taken
    return new[0] > 0.0 and thermal_energy(new) > 0.0, taken
