"""The fluxes of the Euler equations: what they change in a row of cells over a time step.

State per cell (rho, rho u_1 .. rho u_d, E), pressure p = rho T, E = d rho T/2 + rho |u|^2/2, so
gamma = (d + 2)/d; d_t U + div F(U) = 0.

- Finite differences in conservation form; the flux at a face is reconstructed by WENO5 in the
  characteristic variables of the face's Roe average after a Lax-Friedrichs splitting, whose speed is, for
  each characteristic field, the largest over the six cells of the stencil (C.-W. Shu, ICASE report 97-65).
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

import numpy as np

from rvm_mpi.compiling.declare import kernel, part
from rvm_mpi.compiling.simd import LANES, load, maximum, minimum, splat, store, where_positive
from rvm_mpi.fluid.walls import GHOSTS
from rvm_mpi.fluid.weno import FLAT, weno5

#: density and internal energy that a face leaves of the first-order update, at least
KEPT = 1e-2

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


@part
def _five(work, at):  # type: ignore[no-untyped-def]
    """Five slots: the conserved variables, or what belongs to each of them."""
    return (
        load(work, at),
        load(work, at + LANES),
        load(work, at + 2 * LANES),
        load(work, at + 3 * LANES),
        load(work, at + 4 * LANES),
    )


@part
def _keep(work, at, a, b, c, d, e):  # type: ignore[no-untyped-def]
    """Set five slots."""
    store(work, at, a)
    store(work, at + LANES, b)
    store(work, at + 2 * LANES, c)
    store(work, at + 3 * LANES, d)
    store(work, at + 4 * LANES, e)


@part
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


@part
def _low_flux(work, cell):  # type: ignore[no-untyped-def]
    """First-order Lax-Friedrichs flux at the face between a cell and the next, with the larger speed of the two."""
    other = cell + _RECORD
    speed = maximum(load(work, cell + _FASTEST), load(work, other + _FASTEST))
    for c in range(0, 5 * LANES, LANES):
        jump = load(work, other + _STATE + c) - load(work, cell + _STATE + c)
        twice_mean = load(work, cell + _FLUX + c) + load(work, other + _FLUX + c)
        store(work, cell + _LOW + c, 0.5 * (twice_mean - speed * jump))


@part
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


@part
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


@part
def _in_fields(work, at, gamma):  # type: ignore[no-untyped-def]
    """Five slots of a cell in the face's characteristic fields: u - c, entropy, two shears, u + c."""
    q, qn, q1, q2, qe = _five(work, at)
    u, v, w, sound2, sound = _five(work, _MEAN)
    inverse = 1.0 / sound2
    pressure = (gamma - 1.0) * ((load(work, _KINETIC) * q - (u * qn + (v * q1 + w * q2))) + qe) * inverse
    push = sound * (qn - u * q) * inverse
    return 0.5 * (pressure - push), q - pressure, q1 - v * q, q2 - w * q, 0.5 * (pressure + push)


@part
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


@part
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


@part
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


@part
def _inner_energy(density, normal, shear, other, energy):  # type: ignore[no-untyped-def]
    return energy - 0.5 * (normal * normal + (shear * shear + other * other)) / density


@part
def _first_order_update(work, cell, ratio):  # type: ignore[no-untyped-def]
    """First-order update of a cell through its two faces; ratio = d_x dt/h."""
    for c in range(0, 5 * LANES, LANES):
        difference = load(work, cell + _LOW + c) - load(work, cell - _RECORD + _LOW + c)
        store(work, cell + _FIRST + c, load(work, cell + _STATE + c) - ratio * difference)
    density, normal, shear, other, energy = _five(work, cell + _FIRST)
    store(work, cell + _INNER, _inner_energy(density, normal, shear, other, energy))


@part
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


@part
def _limit(work, cell, ratio):  # type: ignore[no-untyped-def]
    """Draw the flux between a cell and the next towards first order as far as either needs it; ratio = d_x dt/h."""
    theta = minimum(_allowed(work, cell, cell, 2.0 * ratio), splat(1.0))
    theta = minimum(_allowed(work, cell, cell + _RECORD, -2.0 * ratio), theta)
    for c in range(0, 5 * LANES, LANES):
        low = load(work, cell + _LOW + c)
        store(work, cell + _HIGH + c, low + theta * (load(work, cell + _HIGH + c) - low))


@part
def _slot(component: int, components: int, axis: int) -> int:
    """Where a sweep along an axis keeps a component: the normal momentum before the others, the energy last."""
    if component == components - 1:
        return 4
    if axis == 1 and (component == 1 or component == 2):
        return 3 - component
    return component


@kernel
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
