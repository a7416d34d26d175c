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

from rvm_mpi.compiling.declare import kernel, part
from rvm_mpi.compiling.simd import LANES, load, maximum, minimum, splat, store, where_positive
from rvm_mpi.fluid.walls import GHOSTS, Side
from rvm_mpi.fluid.weno import FLAT, weno5

if TYPE_CHECKING:
    from rvm_mpi.grid.domain import Domain
    from rvm_mpi.job.job import Job

#: density and internal energy that a face leaves of the first-order update, at least
KEPT = 1e-2
#: a step that loses positivity is repeated as two halves at most this often
HALVINGS = 8

# In the sweep's work array a slot is a vector: a number for each of the rows (or columns) that are swept together.
# First come the slots of a face: its average state and speeds, then what the characteristic fields carry.
_MEAN, _KINETIC, _ENTHALPY, _BOUND = (LANES * slot for slot in (0, 5, 6, 7))  # _MEAN: u, v, w, c^2, c
_FLAT, _SHEAR_FLAT = LANES * 10, LANES * 11  # what `weno5` takes for no roughness, of the fields and of the two shears
_FIELD, _RIGHTWARD, _LEFTWARD, _FACE = (LANES * slot for slot in (12, 17, 47, 77))

# Then records, each a cell and the face on its right. The conserved variables come first (density, normal momentum, two
# tangential momenta, energy), then their fluxes.
_STATE, _FLUX = 0, LANES * 5
_VELOCITY, _FASTEST, _SPEED = LANES * 10, LANES * 15, LANES * 16  # u, v, w, c^2, density; |u - c|, |u|, |u + c|
_HIGH, _LOW = LANES * 19, LANES * 24  # both fluxes
_FIRST, _INNER = LANES * 29, LANES * 34  # the first-order update and its internal energy
_RECORD = LANES * 35


@part(fused=False)
def _five(work, at):  # type: ignore[no-untyped-def]
    """Five slots: the conserved variables, or what belongs to each of them."""
    return (
        load(work, at),
        load(work, at + LANES),
        load(work, at + 2 * LANES),
        load(work, at + 3 * LANES),
        load(work, at + 4 * LANES),
    )


@part(fused=False)
def _keep(work, at, a, b, c, d, e):  # type: ignore[no-untyped-def]
    """Set five slots."""
    store(work, at, a)
    store(work, at + LANES, b)
    store(work, at + 2 * LANES, c)
    store(work, at + 3 * LANES, d)
    store(work, at + 4 * LANES, e)


@part(fused=False)
def _complete(work, cell, gamma):  # type: ignore[no-untyped-def]
    """Velocity, sound speed, fluxes and speeds of one cell's conserved variables."""
    density, normal, first, second, energy = _five(work, cell + _STATE)
    u, v, w = normal / density, first / density, second / density
    pressure = (gamma - 1.0) * (energy - 0.5 * (normal * u + (first * v + second * w)))
    sound2 = gamma * pressure / density
    sound = math.sqrt(sound2)
    _keep(work, cell + _FLUX, normal, normal * u + pressure, first * u, second * u, (energy + pressure) * u)
    _keep(work, cell + _VELOCITY, u, v, w, sound2, density)
    store(work, cell + _FASTEST, abs(u) + sound)
    store(work, cell + _SPEED, abs(u - sound))
    store(work, cell + _SPEED + LANES, abs(u))
    store(work, cell + _SPEED + 2 * LANES, abs(u + sound))


@part(fused=False)
def _low_flux(work, cell):  # type: ignore[no-untyped-def]
    """First-order Lax-Friedrichs flux at the face between a cell and the next, with the larger speed of the two."""
    other = cell + _RECORD
    speed = maximum(load(work, cell + _FASTEST), load(work, other + _FASTEST))
    for c in range(0, 5 * LANES, LANES):
        jump = load(work, other + _STATE + c) - load(work, cell + _STATE + c)
        twice_mean = load(work, cell + _FLUX + c) + load(work, other + _FLUX + c)
        store(work, cell + _LOW + c, 0.5 * (twice_mean - speed * jump))


@part(fused=False)
def _mean_state(work, stencil, gamma):  # type: ignore[no-untyped-def]
    """Roe's average of the two cells beside the face; the largest speed of each field over the six cells."""
    ul, vl, wl, left, a = _five(work, stencil + 2 * _RECORD + _VELOCITY)
    ur, vr, wr, right, b = _five(work, stencil + 3 * _RECORD + _VELOCITY)
    # roots of ratios: those of the densities would round otherwise in a unit twice as large
    larger = maximum(a, b)
    a, b = math.sqrt(a / larger), math.sqrt(b / larger)
    total = a + b
    a, b = a / total, b / total
    u, v, w = a * ul + b * ur, a * vl + b * vr, a * wl + b * wr
    du, dv, dw = ur - ul, vr - vl, wr - wl
    kinetic = 0.5 * (u * u + (v * v + w * w))
    # the average enthalpy less the kinetic energy, written so that it cannot turn negative
    sound2 = a * left + b * right
    sound2 = sound2 + 0.5 * (gamma - 1.0) * (a * b) * (du * du + (dv * dv + dw * dw))
    _keep(work, _MEAN, u, v, w, sound2, math.sqrt(sound2))
    store(work, _KINETIC, kinetic)
    store(work, _ENTHALPY, sound2 / (gamma - 1.0) + kinetic)
    for field in range(0, 3 * LANES, LANES):
        fastest = load(work, stencil + _SPEED + field)
        for s in range(1, 6):
            fastest = maximum(fastest, load(work, stencil + s * _RECORD + _SPEED + field))
        store(work, _BOUND + field, fastest)


@part(fused=False)
def _flatness(work, stencil):  # type: ignore[no-untyped-def]
    """What is no roughness of the split fluxes of six cells: `FLAT` of their natural sizes, squared.

    They are those of mass, rho (|u| + c), and of shear momentum, rho (|u| + c)^2, and not the stencil's own numbers: a
    shear may be zero everywhere, or no more than rounding.
    """
    density, speed = load(work, stencil + _STATE), load(work, stencil + _FASTEST)
    for s in range(1, 6):
        density = maximum(density, load(work, stencil + s * _RECORD + _STATE))
        speed = maximum(speed, load(work, stencil + s * _RECORD + _FASTEST))
    mass = (density * FLAT) * speed
    shear = mass * speed
    store(work, _FLAT, mass * mass)
    store(work, _SHEAR_FLAT, shear * shear)


@part(fused=False)
def _in_fields(work, at, gamma):  # type: ignore[no-untyped-def]
    """Five slots of a cell in the face's characteristic fields: u - c, entropy, two shears, u + c."""
    q, qn, q1, q2, qe = _five(work, at)
    u, v, w, sound2, sound = _five(work, _MEAN)
    inverse = 1.0 / sound2
    pressure = (gamma - 1.0) * ((load(work, _KINETIC) * q - (u * qn + (v * q1 + w * q2))) + qe) * inverse
    push = sound * (qn - u * q) * inverse
    return 0.5 * (pressure - push), q - pressure, q1 - v * q, q2 - w * q, 0.5 * (pressure + push)


@part(fused=False)
def _project(work, cell, split, gamma):  # type: ignore[no-untyped-def]
    """One cell's part of the split fluxes (f + a w)/2 and (f - a w)/2 in the face's characteristic fields."""
    w_slow, w_entropy, w_first, w_second, w_fast = _in_fields(work, cell + _STATE, gamma)
    f_slow, f_entropy, f_first, f_second, f_fast = _in_fields(work, cell + _FLUX, gamma)
    slow, middle, fast = load(work, _BOUND), load(work, _BOUND + LANES), load(work, _BOUND + 2 * LANES)
    w_slow, w_fast = slow * w_slow, fast * w_fast
    w_entropy, w_first, w_second = middle * w_entropy, middle * w_first, middle * w_second
    _keep(
        work,
        _RIGHTWARD + split,
        0.5 * (f_slow + w_slow),
        0.5 * (f_entropy + w_entropy),
        0.5 * (f_first + w_first),
        0.5 * (f_second + w_second),
        0.5 * (f_fast + w_fast),
    )
    _keep(
        work,
        _LEFTWARD + split,
        0.5 * (f_slow - w_slow),
        0.5 * (f_entropy - w_entropy),
        0.5 * (f_first - w_first),
        0.5 * (f_second - w_second),
        0.5 * (f_fast - w_fast),
    )


@part(fused=False)
def _reconstruct(work):  # type: ignore[no-untyped-def]
    """WENO5 of the split fluxes of each characteristic field, from both sides."""
    step = 5 * LANES
    for field in range(0, 5 * LANES, LANES):
        p, m = _RIGHTWARD + field, _LEFTWARD + field
        flat = load(work, _SHEAR_FLAT if field == 2 * LANES or field == 3 * LANES else _FLAT)
        a, b, c = load(work, p), load(work, p + step), load(work, p + 2 * step)
        from_left = weno5(a, b, c, load(work, p + 3 * step), load(work, p + 4 * step), flat)
        a, b, c = load(work, m + 5 * step), load(work, m + 4 * step), load(work, m + 3 * step)
        from_right = weno5(a, b, c, load(work, m + 2 * step), load(work, m + step), flat)
        store(work, _FIELD + field, from_left + from_right)


@part(fused=False)
def _high_flux(work, stencil, gamma):  # type: ignore[no-untyped-def]
    """WENO5 flux at the face between the third and the fourth of six cells, kept with the third."""
    _mean_state(work, stencil, gamma)
    _flatness(work, stencil)
    for s in range(6):
        _project(work, stencil + s * _RECORD, s * 5 * LANES, gamma)
    _reconstruct(work)
    u, v, w, _sound2, sound = _five(work, _MEAN)
    slow, entropy, first, second, fast = _five(work, _FIELD)
    both, push = slow + fast, sound * (fast - slow)
    mass = both + entropy
    heat = load(work, _ENTHALPY) * both + (u * push + load(work, _KINETIC) * entropy)
    _keep(
        work,
        stencil + 2 * _RECORD + _HIGH,
        mass,
        u * mass + push,
        v * mass + first,
        w * mass + second,
        heat + (v * first + w * second),
    )


@part(fused=False)
def _inner_energy(density, normal, shear, other, energy):  # type: ignore[no-untyped-def]
    return energy - 0.5 * (normal * normal + (shear * shear + other * other)) / density


@part(fused=False)
def _first_order_update(work, cell, ratio):  # type: ignore[no-untyped-def]
    """First-order update of a cell through its two faces; ratio = d_x dt/h."""
    for c in range(0, 5 * LANES, LANES):
        difference = load(work, cell + _LOW + c) - load(work, cell - _RECORD + _LOW + c)
        store(work, cell + _FIRST + c, load(work, cell + _STATE + c) - ratio * difference)
    density, normal, shear, other, energy = _five(work, cell + _FIRST)
    store(work, cell + _INNER, _inner_energy(density, normal, shear, other, energy))


@part(fused=False)
def _allowed(work, face, cell, weight):  # type: ignore[no-untyped-def]
    """The part of a face's high-order flux that one of its two cells allows, which loses weight times the flux.

    That half of its update must keep the fraction KEPT of the density and internal energy of the first-order
    update. The internal energy is concave along the way, so its chord bounds it from below.
    """
    density, normal, shear, other, energy = _five(work, cell + _FIRST)
    inner = load(work, cell + _INNER)
    h0, h1, h2, h3, h4 = _five(work, face + _HIGH)
    l0, l1, l2, l3, l4 = _five(work, face + _LOW)
    loss = weight * (h0 - l0)
    spare = (1.0 - KEPT) * density
    share = spare / maximum(loss, spare)
    scale = share * weight
    density = density - share * loss
    normal, shear = normal - scale * (h1 - l1), shear - scale * (h2 - l2)
    other, energy = other - scale * (h3 - l3), energy - scale * (h4 - l4)
    loss = inner - _inner_energy(density, normal, shear, other, energy)
    spare = (1.0 - KEPT) * inner
    share = share * (spare / maximum(loss, spare))
    return where_positive(minimum(density, inner), share, splat(0.0))


@part(fused=False)
def _limit(work, cell, ratio):  # type: ignore[no-untyped-def]
    """Draw the flux between a cell and the next towards first order as far as either needs it; ratio = d_x dt/h."""
    theta = minimum(_allowed(work, cell, cell, 2.0 * ratio), splat(1.0))
    theta = minimum(_allowed(work, cell, cell + _RECORD, -2.0 * ratio), theta)
    for c in range(0, 5 * LANES, LANES):
        low = load(work, cell + _LOW + c)
        store(work, cell + _HIGH + c, low + theta * (load(work, cell + _HIGH + c) - low))


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
    for start in range(0, pencils, LANES):
        for i in range(length + 2 * GHOSTS):
            cell = _FACE + i * _RECORD
            for k in range(LANES):
                p = min(start + k, pencils - 1)
                row, column = (p + wy, i) if axis == 0 else (i, p + wx)
                for c in range(components):
                    work[cell + _STATE + _slot(c, components, axis) * LANES + k] = state[row, column, c]
            _complete(work, cell, gamma)
        for i in range(1, length + 4):
            _low_flux(work, _FACE + i * _RECORD)
        for i in range(2, length + 3):
            _high_flux(work, _FACE + (i - 2) * _RECORD, gamma)
        if solid_lower:
            store(work, _FACE + 2 * _RECORD + _HIGH, splat(0.0))
        if solid_upper:
            store(work, _FACE + (length + 2) * _RECORD + _HIGH, splat(0.0))
        for i in range(2, length + 4):
            _first_order_update(work, _FACE + i * _RECORD, share)
        for i in range(2, length + 3):
            _limit(work, _FACE + i * _RECORD, share)
        for i in range(length):
            face = _FACE + (i + 2) * _RECORD + _HIGH
            for k in range(min(LANES, pencils - start)):
                row, column = (start + k, i) if axis == 0 else (i, start + k)
                for c in range(components):
                    at = face + _slot(c, components, axis) * LANES + k
                    amount = -(ratio * (work[_RECORD + at] - work[at]))
                    change[row, column, c] = amount if axis == 0 else change[row, column, c] + amount


def work_size(cells: int) -> int:
    """Doubles that `sweep` needs for so many cells along its axis."""
    return _FACE + (cells + 2 * GHOSTS) * _RECORD


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

    def prepare(self) -> None:
        """Compile the kernels of a step, or read them from disk, before there is a state; no other rank takes part."""
        self._cool(0.0)
        for axis in range(self.directions):
            self._sweep(axis, 0.0)
            combine(self._interior, self._start, self._change, 1.0)
        self._largest_rate()

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
            self._sweep(axis, dt)

    def _sweep(self, axis: int, dt: float) -> None:
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
        return self._largest_rate()

    def _largest_rate(self) -> float:
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
