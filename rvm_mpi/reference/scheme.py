"""The time integrator: two stages, each of fluxes, drift, correction and relaxation."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rvm_mpi.reference import thermal
from rvm_mpi.reference.boltzmann import boltzmann, penalisation
from rvm_mpi.reference.collisions import DEEPEST, cooling, finished, gaussian_of, haff, relaxation_rate, relaxes
from rvm_mpi.reference.drift import Turning, drift
from rvm_mpi.reference.state import Array, Problem, State, moments, nodewise, powers, sums, temperature
from rvm_mpi.reference.transport import Transport, transport

#: Courant number, over the one wanted, up to which a cell's drift is taken together with transport
FITS = 1.05


class Stage(NamedTuple):
    """A stage, its weights as functions of the relaxation depth z = dt tau/eps.

    (old + new + first + last) g' = old g^n + new (g + dt L(g)) + first G^n + last G',
    U' = a H(U^n) + b H_c(U + dt N(U)), (a, b, c) = `carried`, H Haff's cooling over dt, H_c over c dt.

    `drag` is dt times the drag's rate, from dt times that of now: its mean over the step ahead of or behind the stage.
    The first stage finds the depth once it has used old, new and first: there they must not depend on it.
    """

    old: Callable[[Array], Array]
    new: Callable[[Array], Array]
    first: Callable[[Array], Array]
    last: Callable[[Array], Array]
    carried: tuple[float, float, float]
    drag: Callable[[Array], Array]


STAGES = (
    Stage(
        old=lambda z: 0.0 * z,
        new=lambda z: 1.0 + 0.0 * z,
        first=lambda z: 0.0 * z,
        last=lambda z: z,
        carried=(0.0, 1.0, 1.0),
        drag=lambda x: np.log(1.0 + x),
    ),
    Stage(
        old=lambda z: 0.5 + 0.0 * z,
        new=lambda z: 0.5 * (1.0 + z),
        first=lambda z: 0.5 * z,
        last=lambda z: 0.5 * z**2,
        carried=(0.5, 0.5, 0.0),
        drag=lambda x: -np.log(np.maximum(1.0 - x, 1e-3)),
    ),
)


class Given(NamedTuple):
    """What is fixed over a step: omega at its end and d_t omega/omega where the scaling comes from outside.

    penalty: of a Boltzmann operator, `boltzmann.penalisation`.
    """

    omega: Array
    growth: Array
    penalty: tuple[Array, Array] | None


class Found(NamedTuple):
    """What the first stage leaves for the second: the depth (given where there is a penalty), and frames' rates."""

    depth: Array | None
    rates: thermal.Rates | None = None


def step(p: Problem, state: State, dt: float, omega_end: Array | None = None) -> State:
    """The state after a step.

    Parameters
    ----------
    p : Problem
    state : State
        At t^n.
    dt : float
    omega_end : (ny, nx) array, optional
        omega at the step's end where the scaling is given from outside; else it stays or follows the moments.

    Raises
    ------
    ArithmeticError
        Where the velocity grid cannot hold a Gaussian, or Newton's method does not find it.
    """
    end = state.omega if omega_end is None else omega_end
    penalty = penalisation(p, state, dt) if p.job.collision.explicit else None
    given = Given(end, np.log(end / state.omega) / dt, penalty)
    found = Found(None if penalty is None else dt * penalty[0])
    now = state
    for stage in STAGES:
        now, found = take(p, stage, dt, state, now, given, found)
    return now


def take(
    p: Problem, stage: Stage, dt: float, begin: State, here: State, given: Given, found: Found
) -> tuple[State, Found]:
    """One stage from `here`, of a step that began at `begin`: its result, and what it found for the next."""
    z = np.zeros(here.omega.shape) if found.depth is None else found.depth
    U = here.U if p.carries else moments(p, here)
    rho, T = U[..., 0], temperature(p, U)
    across = thermal.moving_transport(p, here) if p.thermal else transport(p, here)
    rate, N = across.rate, across.moments
    if given.penalty is not None:
        source, heating = boltzmann(p, here, *given.penalty)
        rate, N[..., 4] = rate + source, N[..., 4] + heating

    # U' = a H(U^n) + b H_c(U + dt N(U)), and from it omega = sqrt(2 E/(d rho)), or sqrt(T) where frames move
    U_end, omega, (a, b, c) = here.U, given.omega, stage.carried
    if p.carries:
        U_end = a * haff(p, begin.U, dt) + b * haff(p, here.U + dt * N, c * dt)
    if p.kinetic:
        omega = np.sqrt(2.0 * U_end[..., 4] / (p.d * U_end[..., 0]))

    # the drag (C rho sqrt(T)/eps) div_v((v - u) f) and d_t omega/omega are one number before anything is upwinded
    if p.thermal:
        omega, rates = np.sqrt(temperature(p, U_end)), found.rates
        if rates is None:
            rates = thermal.change(p, U, U + dt * N, dt)
            found = found._replace(rates=rates)
        else:
            rates = thermal.rest(p, begin.U, U, U_end, dt, rates)
        turning = thermal.turning(p, here, rates, across.gradient)
    else:
        beta = stage.drag(dt * cooling(p) * rho * np.sqrt(T)) / dt
        growth = given.growth
        if p.kinetic:  # d_t omega/omega = 1/2 (E'/E - rho'/rho)
            growth = 0.5 * ((N[..., 4] - beta * p.d * rho * T) / U[..., 4] - N[..., 0] / rho)
        mean = U[..., 1:4] / (rho * here.omega)[..., None]
        turning = Turning(growth + beta, across.gradient, beta[..., None] * mean, mean, T / here.omega**2)
    explicit, first = explicit_part(p, stage, dt, begin, here, z, across._replace(rate=rate), turning)

    # sums of 1, xi, |xi|^2/2 that g' is to have: those of U', else what it has by itself
    known, before = stage.old(z) + stage.new(z) + stage.first(z), sums(p, begin.g)
    wanted = (sums(p, explicit) + first[..., None] * before) / known[..., None]
    if p.thermal:
        wanted = U_end[..., :1] / p.weight * np.array([1.0, 0.0, 0.0, 0.0, 0.5 * p.d])
    elif p.job.scheme.conservative:
        wanted = U_end / p.weight / powers(omega)
    if found.depth is None and p.job.collision.relaxation is not None:  # tau/eps averaged over the step
        after = p.weight * wanted * powers(omega)
        tau = relaxation_rate(p, rho, T) + relaxation_rate(p, after[..., 0], temperature(p, after))
        z = np.minimum(0.5 * dt * tau, DEEPEST)
    g = np.empty(here.g.shape)
    for at in np.ndindex(*omega.shape):
        weights = known[at], first[at], stage.last(z)[at]
        g[at] = finished(p, explicit[at], begin.g[at], wanted[at], before[at], weights)
    return State(g, omega, U_end), found._replace(depth=z)


def explicit_part(
    p: Problem, stage: Stage, dt: float, begin: State, here: State, z: Array, across: Transport, turning: Turning
) -> tuple[Array, Array]:
    """old g^n + new (g + dt L(g)), and the weight of G^n that is yet to be added to it.

    Where transport and drift together are too fast for the step the drift is taken by itself (Lawson): P moves over dt
    what belongs to t^n, G^n among it; what belongs to the end of the step is there already.
    """
    drifting = sum(turning.fastest(p, q) for q in range(p.d))
    courant = p.job.time.cfl or 0.5
    substeps = np.maximum(1, np.ceil(dt * drifting / courant)).astype(int)
    substeps[dt * (across.courant + drifting) <= FITS * courant] = 0

    old, new, first = (nodewise(weight(z)) for weight in (stage.old, stage.new, stage.first))
    moved = here.g + dt * across.rate
    explicit = old * begin.g + new * (moved + dt * drift(p, here.g, turning, moved / dt))
    for m in np.unique(substeps[substeps > 0]):
        start, rest = old * begin.g, new * moved
        if here is begin:
            start, rest = start + rest, 0.0 * rest
        for at in np.ndindex(*z.shape):
            if relaxes(p) and first[at] > 0.0:
                start[at] += first[at] * gaussian_of(p, begin.g[at])
        explicit = np.where(nodewise(substeps == m), flow(p, start, turning, dt, int(m)) + rest, explicit)
    return explicit, np.where(substeps > 0, 0.0, stage.first(z))


def flow(p: Problem, g: Array, turning: Turning, dt: float, m: int) -> Array:
    """P: the drift alone over dt by m + 1 stages, each a forward Euler step over dt/m (Spiteri and Ruuth 2002)."""
    moved = g
    for _ in range(m):
        moved = moved + dt / m * drift(p, moved, turning, moved * m / dt)
    return (g + m * (moved + dt / m * drift(p, moved, turning, moved * m / dt))) / (m + 1)
