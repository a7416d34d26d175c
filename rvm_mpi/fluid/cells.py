"""What happens in each cell of the fluid by itself: a Runge-Kutta stage, cooling, the fastest waves, omega."""

from __future__ import annotations

import numpy as np

from rvm_mpi.compiling.declare import kernel, part


@part
def _internal(cell: np.ndarray) -> float:
    """Internal energy density d rho T/2 of one cell's state (d + 2,)."""
    momentum2 = 0.0
    for c in range(1, cell.size - 1):
        momentum2 += cell[c] * cell[c]
    return cell[cell.size - 1] - 0.5 * momentum2 / cell[0]


@kernel
def combine(state: np.ndarray, start: np.ndarray, change: np.ndarray, weight: float) -> int:
    """Runge-Kutta stage: state = (1 - weight) start + weight (state + change).

    Parameters
    ----------
    state : (ny, nx, d + 2) array
        Changed in place.
    start, change : (ny, nx, d + 2) arrays
        State at the beginning of the step; change over it by the fluxes.
    weight : float
        In (0, 1].

    Returns
    -------
    int
        Number of the first cell, ny * nx if there is none, whose density or internal energy is not positive.
    """
    ny, nx, components = state.shape
    lost = ny * nx
    for j in range(ny):
        for i in range(nx):
            for c in range(components):
                stage = state[j, i, c] + change[j, i, c]
                state[j, i, c] = stage if weight == 1.0 else (1.0 - weight) * start[j, i, c] + weight * stage
            if not (state[j, i, 0] > 0.0 and _internal(state[j, i]) > 0.0):
                lost = min(lost, j * nx + i)
    return lost


@kernel
def cool(state: np.ndarray, cooling: float, power: float, dt: float) -> None:
    """The homogeneous cooling of every cell, exact for dT/dt = -2 C rho T^{1 + power/2} (Haff: power 1).

    Parameters
    ----------
    state : (ny, nx, d + 2) array
        Changed in place, its energy only.
    cooling, power, dt : float
        C, the power of the relative speed in the collision kernel, and the time.
    """
    ny, nx, components = state.shape
    for j in range(ny):
        for i in range(nx):
            inner = _internal(state[j, i])
            density = state[j, i, 0]
            temperature = 2.0 * inner / ((components - 2) * density)
            if power == 1.0:
                factor = (1.0 + cooling * density * np.sqrt(temperature) * dt) ** 2
            elif power > 0.0:
                factor = (1.0 + power * cooling * density * temperature ** (0.5 * power) * dt) ** (2.0 / power)
            else:
                factor = np.exp(2.0 * cooling * density * dt)
            state[j, i, components - 1] = (state[j, i, components - 1] - inner) + inner / factor


@kernel
def largest_rate(state: np.ndarray, wy: int, wx: int, inverse_dy: float, inverse_dx: float) -> float:
    """Largest sum over the directions of (|u_n| + c)/h, over the cells and the first layer of ghosts.

    Parameters
    ----------
    state : (ny + 2 wy, nx + 2 wx, d + 2) array
        Ghosted state.
    wy, wx : int
        Its ghost layers.
    inverse_dy, inverse_dx : float
        1/h, 0 in an unused direction.

    Returns
    -------
    float
        NaN if any cell's is.
    """
    d = state.shape[2] - 2
    largest = 0.0
    first_row, first_column = max(wy - 1, 0), max(wx - 1, 0)
    for j in range(first_row, state.shape[0] - first_row):
        for i in range(first_column, state.shape[1] - first_column):
            if not (wy <= j < state.shape[0] - wy or wx <= i < state.shape[1] - wx):
                continue
            cell = state[j, i]
            density = cell[0]
            sound = np.sqrt((2.0 * (d + 2) / (d * d)) * _internal(cell) / density)
            rate = (abs(cell[1]) / density + sound) * inverse_dx
            if d > 1:
                rate += (abs(cell[2]) / density + sound) * inverse_dy
            if not rate <= largest:
                largest = rate
            if largest != largest:
                return largest
    return largest


@kernel
def root_mean_energy(state: np.ndarray, out: np.ndarray) -> None:
    """The scaling omega = sqrt(2E/(d rho)) of every cell: state (ny, nx, d + 2), out (ny, nx)."""
    ny, nx, components = state.shape
    for j in range(ny):
        for i in range(nx):
            out[j, i] = np.sqrt(2.0 * state[j, i, components - 1] / ((components - 2) * state[j, i, 0]))
