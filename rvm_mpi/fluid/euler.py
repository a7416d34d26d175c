"""The macroscopic system: compressible Euler equations with granular cooling.

State per cell (rho, rho u_1 .. rho u_d, E), pressure p = rho T, E = d rho T/2 + rho |u|^2/2, so
gamma = (d + 2)/d; d_t U + div F(U) = (0, 0, - d C rho^2 T^{3/2}), that is dT/dt = -2 C rho T^{3/2} in a
homogeneous gas.

- Space: finite differences in conservation form; the flux at a face is reconstructed by WENO5 in the
  characteristic variables of the face's Roe average after a Lax-Friedrichs splitting, whose speed is, for
  each characteristic field, the largest over the six cells of the stencil (C.-W. Shu, ICASE report 97-65).
- Time: SSP Runge-Kutta of third order between two halves of the cooling, which is integrated exactly.
- Positivity: each direction's update is the mean of the updates through its two faces, and each face's flux
  is drawn towards the first-order Lax-Friedrichs flux until both cells keep positive density and
  temperature (X. Y. Hu, N. A. Adams, C.-W. Shu, J. Comput. Phys. 242 (2013), here about the first-order
  update of the same direction in place of the old state, which leaves more of the high-order flux and allows
  twice the time step). The first-order update of a direction is positive while d_x dt max(|u_n| + c)/h <= 1.

A face's flux depends on the cells of its own row within three cells of it and on nothing else, so results do
not depend on how the domain is cut; sums are ordered so that they know neither left from right nor x from y.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.fluid.walls import GHOSTS, Side
from rvm_mpi.fluid.weno import weno5
from rvm_mpi.kernels import kernel, part

if TYPE_CHECKING:
    from rvm_mpi.domain import Domain
    from rvm_mpi.job import Job

#: rows (or columns) swept together, in the lanes of a vector
LANES = 16
#: density and internal energy that a face leaves of the first-order update, at least
KEPT = 1e-2
#: a step that loses positivity is repeated as two halves at most this often
HALVINGS = 8

# One record of the sweep's work array is a cell and the face on its right; each slot holds LANES numbers.
# The conserved variables come first (density, normal momentum, two tangential momenta, energy), then
# their fluxes.
_STATE, _FLUX = 0, 5
_VELOCITY, _SOUND2, _ROOT, _FASTEST, _SPEED = 10, 13, 14, 15, 16  # _SPEED: |u - c|, |u|, |u + c|
_HIGH, _LOW, _FIRST, _INNER = 19, 24, 29, 34  # both fluxes, first-order update, its internal energy
_THETA = 35  # the part of the high-order flux that is kept
_RECORD = 36

# Slots of a face's own work: its average state and speeds, then what the characteristic fields carry.
_MEAN, _MEAN_SOUND2, _MEAN_SOUND, _KINETIC, _ENTHALPY, _BOUND = 0, 3, 4, 5, 6, 7
_FIELD, _RIGHTWARD, _LEFTWARD = 10, 15, 45
_FACE = 75


@part(fused=False)
def _at(slot: int, lane: int) -> np.uint64:
    """Index of a slot's lane.

    Unsigned, since numba's handling of negative indices would keep the compiler from vectors of lanes; so
    would its `range`, hence the while loops over lanes.
    """
    return np.uint64(slot * LANES + lane)


@part(fused=False)
def _complete(cell: np.ndarray, gamma: float) -> None:
    """Velocity, sound speed, fluxes and speeds of one cell's conserved variables."""
    k = 0
    while k < LANES:
        density, normal = cell[_at(_STATE, k)], cell[_at(_STATE + 1, k)]
        first, second, energy = cell[_at(_STATE + 2, k)], cell[_at(_STATE + 3, k)], cell[_at(_STATE + 4, k)]
        u, v, w = normal / density, first / density, second / density
        pressure = (gamma - 1.0) * (energy - 0.5 * (normal * u + (first * v + second * w)))
        sound2 = gamma * pressure / density
        sound = np.sqrt(sound2)
        cell[_at(_FLUX, k)] = normal
        cell[_at(_FLUX + 1, k)] = normal * u + pressure
        cell[_at(_FLUX + 2, k)] = first * u
        cell[_at(_FLUX + 3, k)] = second * u
        cell[_at(_FLUX + 4, k)] = (energy + pressure) * u
        cell[_at(_VELOCITY, k)] = u
        cell[_at(_VELOCITY + 1, k)] = v
        cell[_at(_VELOCITY + 2, k)] = w
        cell[_at(_SOUND2, k)] = sound2
        cell[_at(_ROOT, k)] = np.sqrt(density)
        cell[_at(_FASTEST, k)] = abs(u) + sound
        cell[_at(_SPEED, k)] = abs(u - sound)
        cell[_at(_SPEED + 1, k)] = abs(u)
        cell[_at(_SPEED + 2, k)] = abs(u + sound)
        k += 1


@part(fused=False)
def _low_flux(pair: np.ndarray) -> None:
    """First-order Lax-Friedrichs flux at the face between two cells, with the larger speed of the two."""
    for c in range(5):
        k = 0
        while k < LANES:
            a, b = pair[_at(_FASTEST, k)], pair[_at(_RECORD + _FASTEST, k)]
            speed = a if a > b else b
            jump = pair[_at(_RECORD + _STATE + c, k)] - pair[_at(_STATE + c, k)]
            twice_mean = pair[_at(_FLUX + c, k)] + pair[_at(_RECORD + _FLUX + c, k)]
            pair[_at(_LOW + c, k)] = 0.5 * (twice_mean - speed * jump)
            k += 1


@part(fused=False)
def _mean_state(stencil: np.ndarray, face: np.ndarray, gamma: float) -> None:
    """Roe's average of the two cells beside the face; the largest speed of each field over the six cells."""
    left, right = 2 * _RECORD, 3 * _RECORD
    k = 0
    while k < LANES:
        a, b = stencil[_at(left + _ROOT, k)], stencil[_at(right + _ROOT, k)]
        total = a + b
        a, b = a / total, b / total
        ul, ur = stencil[_at(left + _VELOCITY, k)], stencil[_at(right + _VELOCITY, k)]
        vl, vr = stencil[_at(left + _VELOCITY + 1, k)], stencil[_at(right + _VELOCITY + 1, k)]
        wl, wr = stencil[_at(left + _VELOCITY + 2, k)], stencil[_at(right + _VELOCITY + 2, k)]
        u, v, w = a * ul + b * ur, a * vl + b * vr, a * wl + b * wr
        du, dv, dw = ur - ul, vr - vl, wr - wl
        kinetic = 0.5 * (u * u + (v * v + w * w))
        # the average enthalpy less the kinetic energy, written so that it cannot turn negative
        sound2 = a * stencil[_at(left + _SOUND2, k)] + b * stencil[_at(right + _SOUND2, k)]
        sound2 += 0.5 * (gamma - 1.0) * (a * b) * (du * du + (dv * dv + dw * dw))
        face[_at(_MEAN, k)] = u
        face[_at(_MEAN + 1, k)] = v
        face[_at(_MEAN + 2, k)] = w
        face[_at(_MEAN_SOUND2, k)] = sound2
        face[_at(_MEAN_SOUND, k)] = np.sqrt(sound2)
        face[_at(_KINETIC, k)] = kinetic
        face[_at(_ENTHALPY, k)] = sound2 / (gamma - 1.0) + kinetic
        k += 1
    for field in range(3):
        slot = _SPEED + field
        k = 0
        while k < LANES:
            a, b = stencil[_at(slot, k)], stencil[_at(_RECORD + slot, k)]
            c, d = stencil[_at(2 * _RECORD + slot, k)], stencil[_at(3 * _RECORD + slot, k)]
            e, f = stencil[_at(4 * _RECORD + slot, k)], stencil[_at(5 * _RECORD + slot, k)]
            a, c, e = (a if a > b else b), (c if c > d else d), (e if e > f else f)
            a = a if a > c else c
            face[_at(_BOUND + field, k)] = a if a > e else e
            k += 1


@part(fused=False)
def _project(cell: np.ndarray, face: np.ndarray, split: np.ndarray, gamma: float) -> None:
    """One cell's part of the split fluxes (f + a w)/2 and (f - a w)/2 in the face's characteristic fields.

    The fields: u - c, entropy, two shears, u + c.
    """
    leftward = _LEFTWARD - _RIGHTWARD
    k = 0
    while k < LANES:
        u, v, w = face[_at(_MEAN, k)], face[_at(_MEAN + 1, k)], face[_at(_MEAN + 2, k)]
        sound2, sound, kinetic = face[_at(_MEAN_SOUND2, k)], face[_at(_MEAN_SOUND, k)], face[_at(_KINETIC, k)]
        slow, middle, fast = face[_at(_BOUND, k)], face[_at(_BOUND + 1, k)], face[_at(_BOUND + 2, k)]
        inverse = 1.0 / sound2

        q, qn, qe = cell[_at(_STATE, k)], cell[_at(_STATE + 1, k)], cell[_at(_STATE + 4, k)]
        q1, q2 = cell[_at(_STATE + 2, k)], cell[_at(_STATE + 3, k)]
        pressure = (gamma - 1.0) * ((kinetic * q - (u * qn + (v * q1 + w * q2))) + qe) * inverse
        push = sound * (qn - u * q) * inverse
        w_slow, w_fast = 0.5 * (pressure - push), 0.5 * (pressure + push)
        w_entropy, w_first, w_second = q - pressure, q1 - v * q, q2 - w * q

        q, qn, qe = cell[_at(_FLUX, k)], cell[_at(_FLUX + 1, k)], cell[_at(_FLUX + 4, k)]
        q1, q2 = cell[_at(_FLUX + 2, k)], cell[_at(_FLUX + 3, k)]
        pressure = (gamma - 1.0) * ((kinetic * q - (u * qn + (v * q1 + w * q2))) + qe) * inverse
        push = sound * (qn - u * q) * inverse
        f_slow, f_fast = 0.5 * (pressure - push), 0.5 * (pressure + push)
        f_entropy, f_first, f_second = q - pressure, q1 - v * q, q2 - w * q

        split[_at(0, k)] = 0.5 * (f_slow + slow * w_slow)
        split[_at(1, k)] = 0.5 * (f_entropy + middle * w_entropy)
        split[_at(2, k)] = 0.5 * (f_first + middle * w_first)
        split[_at(3, k)] = 0.5 * (f_second + middle * w_second)
        split[_at(4, k)] = 0.5 * (f_fast + fast * w_fast)
        split[_at(leftward, k)] = 0.5 * (f_slow - slow * w_slow)
        split[_at(leftward + 1, k)] = 0.5 * (f_entropy - middle * w_entropy)
        split[_at(leftward + 2, k)] = 0.5 * (f_first - middle * w_first)
        split[_at(leftward + 3, k)] = 0.5 * (f_second - middle * w_second)
        split[_at(leftward + 4, k)] = 0.5 * (f_fast - fast * w_fast)
        k += 1


@part(fused=False)
def _reconstruct(face: np.ndarray) -> None:
    """WENO5 of the split fluxes of each characteristic field, from both sides."""
    for field in range(5):
        p, m = _RIGHTWARD + field, _LEFTWARD + field
        k = 0
        while k < LANES:
            a, b, c = face[_at(p, k)], face[_at(p + 5, k)], face[_at(p + 10, k)]
            from_left = weno5(a, b, c, face[_at(p + 15, k)], face[_at(p + 20, k)])
            a, b, c = face[_at(m + 25, k)], face[_at(m + 20, k)], face[_at(m + 15, k)]
            from_right = weno5(a, b, c, face[_at(m + 10, k)], face[_at(m + 5, k)])
            face[_at(_FIELD + field, k)] = from_left + from_right
            k += 1


@part(fused=False)
def _assemble(face: np.ndarray, cell: np.ndarray) -> None:
    """From the characteristic fields back to the flux, kept in the record of the cell on the face's left."""
    k = 0
    while k < LANES:
        u, v, w = face[_at(_MEAN, k)], face[_at(_MEAN + 1, k)], face[_at(_MEAN + 2, k)]
        slow, entropy, fast = face[_at(_FIELD, k)], face[_at(_FIELD + 1, k)], face[_at(_FIELD + 4, k)]
        first, second = face[_at(_FIELD + 2, k)], face[_at(_FIELD + 3, k)]
        both, push = slow + fast, face[_at(_MEAN_SOUND, k)] * (fast - slow)
        mass = both + entropy
        heat = face[_at(_ENTHALPY, k)] * both + (u * push + face[_at(_KINETIC, k)] * entropy)
        cell[_at(_HIGH, k)] = mass
        cell[_at(_HIGH + 1, k)] = u * mass + push
        cell[_at(_HIGH + 2, k)] = v * mass + first
        cell[_at(_HIGH + 3, k)] = w * mass + second
        cell[_at(_HIGH + 4, k)] = heat + (v * first + w * second)
        k += 1


@part(fused=False)
def _high_flux(stencil: np.ndarray, face: np.ndarray, gamma: float) -> None:
    """WENO5 flux at the face between the third and the fourth of six cells."""
    _mean_state(stencil, face, gamma)
    for s in range(6):
        _project(stencil[s * _RECORD * LANES :], face, face[(_RIGHTWARD + 5 * s) * LANES :], gamma)
    _reconstruct(face)
    _assemble(face, stencil[2 * _RECORD * LANES :])


@part(fused=False)
def _first_order_update(pair: np.ndarray, ratio: float) -> None:
    """First-order update of the right one of two cells through its two faces; ratio = d_x dt/h."""
    for c in range(5):
        k = 0
        while k < LANES:
            difference = pair[_at(_RECORD + _LOW + c, k)] - pair[_at(_LOW + c, k)]
            pair[_at(_RECORD + _FIRST + c, k)] = pair[_at(_RECORD + _STATE + c, k)] - ratio * difference
            k += 1
    first = _RECORD + _FIRST
    k = 0
    while k < LANES:
        normal, shear, other = pair[_at(first + 1, k)], pair[_at(first + 2, k)], pair[_at(first + 3, k)]
        kinetic = 0.5 * (normal * normal + (shear * shear + other * other)) / pair[_at(first, k)]
        pair[_at(_RECORD + _INNER, k)] = pair[_at(first + 4, k)] - kinetic
        k += 1


@part(fused=False)
def _allowed(pair: np.ndarray, cell: int, weight: float) -> None:
    """Lower the face's theta to what one of its two cells allows, which loses weight times the flux.

    That half of its update must keep the fraction KEPT of the density and internal energy of the first-order
    update. The internal energy is concave along the way, so its chord bounds it from below.
    """
    first = cell + _FIRST
    k = 0
    while k < LANES:
        density, inner = pair[_at(first, k)], pair[_at(cell + _INNER, k)]
        loss = weight * (pair[_at(_HIGH, k)] - pair[_at(_LOW, k)])
        spare = (1.0 - KEPT) * density
        part = spare / (loss if loss > spare else spare)
        scale = part * weight
        density = density - part * loss
        normal = pair[_at(first + 1, k)] - scale * (pair[_at(_HIGH + 1, k)] - pair[_at(_LOW + 1, k)])
        shear = pair[_at(first + 2, k)] - scale * (pair[_at(_HIGH + 2, k)] - pair[_at(_LOW + 2, k)])
        other = pair[_at(first + 3, k)] - scale * (pair[_at(_HIGH + 3, k)] - pair[_at(_LOW + 3, k)])
        energy = pair[_at(first + 4, k)] - scale * (pair[_at(_HIGH + 4, k)] - pair[_at(_LOW + 4, k)])
        loss = inner - (energy - 0.5 * (normal * normal + (shear * shear + other * other)) / density)
        spare = (1.0 - KEPT) * inner
        part *= spare / (loss if loss > spare else spare)
        worst = density if density < inner else inner
        part = part if worst > 0.0 else 0.0
        theta = pair[_at(_THETA, k)]
        pair[_at(_THETA, k)] = part if part < theta else theta
        k += 1


@part(fused=False)
def _limit(pair: np.ndarray, ratio: float) -> None:
    """Draw the flux between two cells towards first order as far as either needs it; ratio = d_x dt/h."""
    k = 0
    while k < LANES:
        pair[_at(_THETA, k)] = 1.0
        k += 1
    _allowed(pair, 0, 2.0 * ratio)
    _allowed(pair, _RECORD, -2.0 * ratio)
    for c in range(5):
        k = 0
        while k < LANES:
            low = pair[_at(_LOW + c, k)]
            pair[_at(_HIGH + c, k)] = low + pair[_at(_THETA, k)] * (pair[_at(_HIGH + c, k)] - low)
            k += 1


@part(fused=False)
def _slot(component: int, components: int, axis: int) -> int:
    """Where a sweep along an axis keeps a component: the normal momentum before the others, the energy last."""
    if component == components - 1:
        return 4
    if axis == 1 and (component == 1 or component == 2):
        return 3 - component
    return component


@kernel(fused=False)
def sweep(
    state: np.ndarray,
    change: np.ndarray,
    axis: int,
    directions: int,
    ratio: float,
    solid_lower: bool,
    solid_upper: bool,
    work: np.ndarray,
) -> None:
    """Change of the state over a time step by the fluxes of one direction.

    Parameters
    ----------
    state : (ny + 2 wy, nx + 2 wx, d + 2) array
        Ghosted state; corners are not read.
    change : (ny, nx, d + 2) array
        -dt/h times the difference of the fluxes: set by the sweep in x (axis 0), added to by that in y (axis
    1). axis : int
        0 for x, 1 for y.
    directions : int
        Space dimensions d_x.
    ratio : float
        dt/h.
    solid_lower, solid_upper : bool
        Whether the block's first and last face is a wall that no mass crosses.
    work : array of at least ``work_size(n)`` zeros for n cells along the axis
        Its unused slots must stay zero from call to call.
    """
    ny, nx, components = change.shape
    d = components - 2
    gamma = (d + 2.0) / d
    wy = GHOSTS if directions == 2 else 0
    wx = GHOSTS
    length, pencils = (nx, ny) if axis == 0 else (ny, nx)
    share = directions * ratio
    face, records = work[: _FACE * LANES], work[_FACE * LANES :]
    size = _RECORD * LANES
    for start in range(0, pencils, LANES):
        for i in range(length + 2 * GHOSTS):
            cell = records[i * size :]
            k = 0
            while k < LANES:
                p = min(start + k, pencils - 1)
                row, column = (p + wy, i) if axis == 0 else (i, p + wx)
                for c in range(components):
                    cell[_at(_STATE + _slot(c, components, axis), k)] = state[row, column, c]
                k += 1
            _complete(cell, gamma)
        for i in range(1, length + 4):
            _low_flux(records[i * size :])
        for i in range(2, length + 3):
            _high_flux(records[(i - 2) * size :], face, gamma)
        k = 0
        while k < LANES:
            if solid_lower:
                records[_at(2 * _RECORD + _HIGH, k)] = 0.0
            if solid_upper:
                records[_at((length + 2) * _RECORD + _HIGH, k)] = 0.0
            k += 1
        for i in range(2, length + 4):
            _first_order_update(records[(i - 1) * size :], share)
        for i in range(2, length + 3):
            _limit(records[i * size :], share)
        for i in range(length):
            faces = records[(i + 2) * size :]
            for k in range(min(LANES, pencils - start)):
                row, column = (start + k, i) if axis == 0 else (i, start + k)
                for c in range(components):
                    slot = _HIGH + _slot(c, components, axis)
                    amount = -(ratio * (faces[_at(_RECORD + slot, k)] - faces[_at(slot, k)]))
                    change[row, column, c] = amount if axis == 0 else change[row, column, c] + amount


def work_size(cells: int) -> int:
    """Doubles that `sweep` needs for so many cells along its axis."""
    return (_FACE + (cells + 2 * GHOSTS) * _RECORD) * LANES


@part(fused=False)
def _internal(cell: np.ndarray) -> float:
    """Internal energy density d rho T/2 of one cell's state (d + 2,)."""
    momentum2 = 0.0
    for c in range(1, cell.size - 1):
        momentum2 += cell[c] * cell[c]
    return cell[cell.size - 1] - 0.5 * momentum2 / cell[0]


@kernel(fused=False)
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


@kernel(fused=False)
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


@kernel(fused=False)
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


@kernel(fused=False)
def root_mean_energy(state: np.ndarray, out: np.ndarray) -> None:
    """The scaling omega = sqrt(2E/(d rho)) of every cell: state (ny, nx, d + 2), out (ny, nx)."""
    ny, nx, components = state.shape
    for j in range(ny):
        for i in range(nx):
            out[j, i] = np.sqrt(2.0 * state[j, i, components - 1] / ((components - 2) * state[j, i, 0]))


class PositivityLost(FloatingPointError):
    """Density or temperature of the fluid is not positive, whatever dt; the same on every rank.

    Attributes
    ----------
    cell : (i, j)
        Global indices of the first such cell.
    """

    def __init__(self, message: str, cell: tuple[int, int]) -> None:
        super().__init__(message)
        self.cell = cell


class FluidSystem:
    """The macroscopic system on this rank's cells.

    Parameters
    ----------
    job : Job
        Its space, velocity.dimensions and collision.cooling are used.
    domain : Domain
        Who owns which cells, and the exchange of ghosts.

    Attributes
    ----------
    state : (ny + 2 wy, nx + 2 wx, d + 2) array
        (rho, rho u, E) with three ghost layers in each active direction.
    cooling : float
        C in dT/dt = -2 C rho T^{3/2}.
    """

    def __init__(self, job: Job, domain: Domain) -> None:
        self.domain = domain
        self.directions = domain.dimensions
        self.velocity_dimensions = d = int(job.velocity.dimensions)
        if self.directions > d:
            raise ValueError(f"{self.directions} space dimensions need as many velocity dimensions, not {d}")
        self.cooling = float(job.collision.cooling)
        self.power = 1.0 if job.collision.exponent is None else float(job.collision.exponent)
        nx, ny = domain.local
        if min(domain.local[: self.directions], default=GHOSTS) < GHOSTS:
            raise ValueError(f"the fluid needs {GHOSTS} cells or more in each direction, not {nx} x {ny}")
        self._wx = GHOSTS if self.directions >= 1 else 0
        self._wy = GHOSTS if self.directions == 2 else 0
        self.state = np.zeros((ny + 2 * self._wy, nx + 2 * self._wx, d + 2))
        self.state[..., 0], self.state[..., -1] = 1.0, 0.5 * d
        self._interior = self.state[self._wy : self._wy + ny, self._wx : self._wx + nx]
        self._saved, self._start, self._change = (np.empty_like(self._interior) for _ in range(3))
        self._work = np.zeros(work_size(max(nx, ny)))
        names = [f"{axis}-{end}" for axis in "xy"[: self.directions] for end in ("lower", "upper")]
        self._sides = {name: Side(name, job.space.sides[name], d) for name in names if domain.on_side(name)}

    @property
    def interior(self) -> np.ndarray:
        """The state of this rank's cells, (ny, nx, d + 2), a view."""
        return self._interior

    def set_state(self, density: np.ndarray, velocity: np.ndarray, temperature: np.ndarray) -> None:
        """Set the initial state; far fields without a state of their own keep it at their side from now on.

        Parameters
        ----------
        density, temperature : (ny, nx) arrays
            Both positive.
        velocity : (ny, nx, d) array

        Raises
        ------
        ValueError
            If a density or temperature is not positive.
        """
        if not (np.all(density > 0.0) and np.all(temperature > 0.0)):
            raise ValueError("the fluid needs a positive density and temperature in every cell")
        d, inside = self.velocity_dimensions, self._interior
        speed2 = np.zeros(inside.shape[:2])
        for c in range(d):
            inside[..., 1 + c] = density * velocity[..., c]
            speed2 += velocity[..., c] ** 2
        inside[..., 0] = density
        inside[..., -1] = 0.5 * density * (d * temperature + speed2)
        for side in self._sides.values():
            side.remember(self.state)
        self.fill_ghosts()

    def fill_ghosts(self) -> None:
        """Fill the ghosts of the state: by the domain (collective), then at the physical sides."""
        if self.directions == 0:
            return
        self.domain.exchange(self.state, GHOSTS)
        for side in self._sides.values():
            side.fill(self.state)

    def advance(self, dt: float) -> None:
        """One time step; collective. Positive for max_rate() dt <= 1/2.

        The speeds may grow within a step. Should a stage lose positivity by it, all ranks repeat the step as
        two halves.

        Parameters
        ----------
        dt : float

        Raises
        ------
        PositivityLost
            On every rank, if positivity is lost whatever dt.
        """
        self._advance(dt, HALVINGS)

    def _advance(self, dt: float, halvings: int) -> None:
        self._saved[:] = self._interior
        self._cool(0.5 * dt)
        lost = self._transport(dt) if self.directions else None
        if self.domain.maximum(0.0 if lost is None else 1.0)[0] > 0.0:
            self._interior[:] = self._saved
            if halvings == 0:
                raise self._complaint(lost, dt)
            self._advance(0.5 * dt, halvings - 1)
            self._advance(0.5 * dt, halvings - 1)
            return
        self._cool(0.5 * dt)

    def _cool(self, dt: float) -> None:
        if self.cooling != 0.0:
            cool(self._interior, self.cooling, self.power, dt)

    def _transport(self, dt: float) -> tuple[int, int] | None:
        """SSP Runge-Kutta step of the fluxes; the first cell (row, column) to lose positivity, if any."""
        inside, first = self._interior, None
        self._start[:] = inside
        for weight in (1.0, 0.25, 2.0 / 3.0):
            self._fluxes(dt)
            lost = combine(inside, self._start, self._change, weight)
            if first is None and lost < inside.shape[0] * inside.shape[1]:
                first = divmod(lost, inside.shape[1])
        return first

    def _fluxes(self, dt: float) -> None:
        """Change of the state by its fluxes over dt, with its ghosts filled first."""
        self.fill_ghosts()
        for axis in range(self.directions):
            lower, upper = (f"{'xy'[axis]}-{end}" for end in ("lower", "upper"))
            sweep(
                self.state,
                self._change,
                axis,
                self.directions,
                dt / self.domain.spacing[axis],
                lower in self._sides and self._sides[lower].solid,
                upper in self._sides and self._sides[upper].solid,
                self._work,
            )

    def _complaint(self, lost: tuple[int, int] | None, dt: float) -> PositivityLost:
        """What to say, the same on all ranks: it names the first cell of all."""
        density, _velocity, temperature = self.moments()
        bad = np.argwhere(~((density > 0.0) & (temperature > 0.0)))
        if bad.size:  # it came in with the state
            lost = (int(bad[0, 0]), int(bad[0, 1]))
        (i0, j0), nx = self.domain.start, self.domain.cells[0]
        mine = -math.inf if lost is None else -float((lost[0] + j0) * nx + lost[1] + i0)
        j, i = divmod(int(-self.domain.maximum(mine)[0]), nx)
        what = f"the fluid lost positive density or temperature at any step down to {dt:.3g}"
        return PositivityLost(f"{what} in {self.domain.place((i, j))}", (i, j))

    def max_rate(self) -> float:
        """Largest sum over directions of (|u_n| + c)/h, here and just outside; collective: fills ghosts."""
        self.fill_ghosts()
        dx, dy = self.domain.spacing
        return float(
            largest_rate(
                self.state,
                self._wy,
                self._wx,
                1.0 / dy if self.directions == 2 else 0.0,
                1.0 / dx if self.directions >= 1 else 0.0,
            )
        )

    def moments(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Density (ny, nx), velocity (ny, nx, d) and temperature (ny, nx) of this rank's cells, copies."""
        inside, d = self._interior, self.velocity_dimensions
        density = inside[..., 0].copy()
        velocity = inside[..., 1:-1] / density[..., None]
        momentum2 = np.zeros_like(density)
        for c in range(d):
            momentum2 += inside[..., 1 + c] ** 2
        return density, velocity, 2.0 * (inside[..., -1] - 0.5 * momentum2 / density) / (d * density)

    def omega(self, out: np.ndarray | None = None) -> np.ndarray:
        """The scaling omega = sqrt(2E/(d rho)).

        Parameters
        ----------
        out : (ny + 2 wy, nx + 2 wx) array, optional
            Filled in place: this rank's cells, or with up to three ghost layers in the active directions.
            With ghosts the call is collective; those of the corners are of no use, but finite.

        Returns
        -------
        array
            `out`, or a new (ny, nx) array.
        """
        ny, nx = self._interior.shape[:2]
        if out is None:
            out = np.empty((ny, nx))
        ghosts_y, ghosts_x = (out.shape[0] - ny) // 2, (out.shape[1] - nx) // 2
        if ghosts_y or ghosts_x:
            self.fill_ghosts()
        y, x = self._wy - ghosts_y, self._wx - ghosts_x
        if min(y, x) < 0 or out.shape != (ny + 2 * ghosts_y, nx + 2 * ghosts_x):
            raise ValueError(f"omega of {ny} x {nx} cells does not fill an array of shape {out.shape}")
        root_mean_energy(self.state[y : y + out.shape[0], x : x + out.shape[1]], out)
        return out

    def relax_towards(self, kinetic: np.ndarray, rate: float, dt: float) -> None:
        """Draw the state towards the kinetic moments: U += (1 - exp(-rate dt)) (U_kinetic - U).

        Parameters
        ----------
        kinetic : (ny, nx, d + 2) array
            (rho, rho u, E) of this rank's cells.
        rate, dt : float
            scaling.synchronise and the time.
        """
        self._interior += -math.expm1(-rate * dt) * (kinetic - self._interior)
