"""What depends on more than one key of a job: checks, and the defaults that follow from other keys."""

from __future__ import annotations

import os
from collections.abc import Iterable
from fractions import Fraction
from itertools import pairwise
from math import exp, isfinite, log, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rvm_mpi import kinetic_theory
from rvm_mpi.job.schema import (
    MOST_SNAPSHOTS,
    Bkw,
    Boundaries,
    Boundary,
    Collision,
    Fluid,
    FromRun,
    Output,
    RandomDensity,
    Relaxation,
    Riemann,
    Section,
    Sides,
    Space,
    SpacedTimes,
    TemperatureDisc,
    Time,
    TwoGaussians,
    Uniform,
    Vector,
    Velocity,
    Wave,
    both_sides,
)
from rvm_mpi.job.text import JobError, KeyProblem, shown

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

AXES = ("x", "y", "z")
MOST_CELLS = 2**28
"""Cells in all: the small fields on them, up to five numbers a cell, stay within PETSc's 32-bit indices."""
MOST_VELOCITIES = 2**24
ROUNDED = 2e-4
"""Relative distance at which a Prandtl number just below its bound counts as that bound, rounded (0.6666)."""

_S = TypeVar("_S", bound=Section)


def _updated(section: _S, **values: Any) -> _S:
    return section.model_copy(update=values)


def resolve(job: Job) -> Job:
    """Check what depends on several keys and write the defaults out; KeyProblem for what does not fit."""
    d = job.velocity.dimensions
    velocity = _resolve_velocity(job.velocity)
    space = _resolve_space(job.space, d)
    collision = _resolve_collision(job.collision, d)
    time = _resolve_time(job.time)
    job = _updated(
        job,
        space=space,
        velocity=velocity,
        collision=collision,
        fluid=_resolve_fluid(job.fluid, job.scaling.kind),
        time=time,
        output=_resolve_output(job.output, time.end),
        initial=_RESOLVE_STATE[type(job.initial)](job.initial, space, d, collision),
    )
    _check_choices(job)
    return job


def _check_choices(job: Job) -> None:
    """Choices that exclude each other, and what the results could not hold."""
    if "\0" in job.title:
        raise KeyProblem("title", "holds the character \\u0000", job.title, "any other text")
    kind = job.scaling.kind
    if job.scaling.synchronise != 0.0 and kind != "macroscopic":
        raise KeyProblem(
            "scaling.synchronise",
            f'not used with scaling.kind = "{kind}"',
            job.scaling.synchronise,
            'other than 0 with scaling.kind = "macroscopic" only',
        )
    if job.scaling.synchronise == "auto" and job.space.dimensions == 0:
        raise KeyProblem(
            "scaling.synchronise", "no cell sets an automatic rate without space", "auto", "a rate >= 0"
        )
    if job.collision.operator == "boltzmann":
        if len(set(job.velocity.half_width)) > 1:
            raise KeyProblem(
                "velocity.half_width",
                "the Boltzmann operator needs the same in each direction",
                job.velocity.half_width,
                "one number",
            )
        if min(job.velocity.points) < 4:
            raise KeyProblem(
                "velocity.points", "too few for the Boltzmann operator", job.velocity.points, "4 or more each"
            )
        if job.collision.method == "fast":
            raise KeyProblem("collision.method", "not in this version", "fast", '"direct"')
    if kind == "kinetic" and not job.scheme.conservative and job.space.dimensions > 0:
        raise KeyProblem(
            "scheme.conservative",
            "the kinetic scaling is unstable in space without the correction of the moments",
            False,
            "true, or another scaling.kind, or no space (space.cells = [])",
        )


def _resolve_fluid(fluid: Fluid, kind: str) -> Fluid:
    """Only the macroscopic scaling needs the fluid system; beside another it runs for comparison, if asked for."""
    needed = kind == "macroscopic"
    if needed and fluid.enabled is False:
        raise KeyProblem(
            "fluid.enabled", 'scaling.kind = "macroscopic" takes omega from the fluid system', False, "true"
        )
    return _updated(fluid, enabled=needed if fluid.enabled is None else fluid.enabled)


def _resolve_velocity(velocity: Velocity) -> Velocity:
    d = velocity.dimensions
    if prod(velocity.points) > MOST_VELOCITIES:
        raise KeyProblem(
            "velocity.points", "too many points in all", velocity.points, f"at most {MOST_VELOCITIES}"
        )
    if len(velocity.half_width) != d:
        raise KeyProblem(
            "velocity.half_width",
            "wrong number of entries",
            velocity.half_width,
            f"one number, or a list of {d}",
        )
    return velocity


def _resolve_space(space: Space, d: int) -> Space:
    n = space.dimensions
    if n > d:
        raise KeyProblem(
            "space.cells",
            "more space dimensions than velocity dimensions",
            space.cells,
            f"at most {d} {'entry' if d == 1 else 'entries'} with this velocity.points",
        )
    if prod(space.cells) > MOST_CELLS:
        raise KeyProblem("space.cells", "too many cells in all", space.cells, f"at most {MOST_CELLS}")
    lower = _vector("space.lower", space.lower, n, 0.0, "space")
    upper = _vector("space.upper", space.upper, n, 1.0, "space")
    for low, high, cells in zip(lower, upper, space.cells, strict=True):
        if not low < high:
            raise KeyProblem(
                "space.upper", "not above space.lower", upper, f"above {shown(lower)} everywhere"
            )
        width = (high - low) / cells
        if not isfinite(high - low) or width < 1e-9 * max(abs(low), abs(high)) or width * width == 0.0:
            raise KeyProblem("space.upper", "cells too narrow or too wide for double precision", upper)
    return _updated(space, lower=lower, upper=upper, boundary=_resolve_boundaries(space, d))


def _resolve_boundaries(space: Space, d: int) -> Boundaries:
    given = space.boundary
    resolved: dict[str, Sides | None] = {}
    for axis, (name, both) in enumerate((("x", given.x), ("y", given.y))):
        key = f"space.boundary.{name}"
        if axis >= space.dimensions:
            if both is not None:
                raise KeyProblem(
                    key,
                    f"space has no {name} direction",
                    space.cells,
                    "boundaries of space.cells' directions",
                )
            resolved[name] = None
            continue
        both = both or Sides.model_validate(both_sides("periodic"))
        if (both.lower.kind == "periodic") != (both.upper.kind == "periodic"):
            raise KeyProblem(
                key,
                "periodic on one side only",
                [both.lower.kind, both.upper.kind],
                "periodic on both sides or on none",
            )
        resolved[name] = Sides(
            lower=_resolve_boundary(f"{key}.lower", both.lower, axis, d),
            upper=_resolve_boundary(f"{key}.upper", both.upper, axis, d),
        )
    return Boundaries(**resolved)


_BOUNDARY_KEYS = {
    "maxwell": ("accommodation", "temperature", "velocity"),
    "diffuse": ("temperature", "velocity"),
    "far-field": ("density", "temperature", "velocity"),
}


def _resolve_boundary(key: str, side: Boundary, axis: int, d: int) -> Boundary:
    used = _BOUNDARY_KEYS.get(side.kind, ())
    for name in ("accommodation", "temperature", "density", "velocity"):
        value = getattr(side, name)
        if value is not None and name not in used:
            raise KeyProblem(f"{key}.{name}", f'not used by "{side.kind}"', value, ", ".join(("kind", *used)))
    if side.kind in ("maxwell", "diffuse"):
        velocity = _vector(f"{key}.velocity", side.velocity, d, 0.0, "velocity")
        if velocity[axis] != 0.0:
            raise KeyProblem(
                f"{key}.velocity", "a wall cannot move along its normal", velocity, f"0 along {AXES[axis]}"
            )
        return Boundary(
            kind="maxwell",
            accommodation=1.0 if side.accommodation is None else side.accommodation,
            temperature=1.0 if side.temperature is None else side.temperature,
            velocity=velocity,
        )
    if side.kind == "far-field" and (side.density, side.temperature, side.velocity) != (None, None, None):
        for name in ("density", "temperature"):
            if getattr(side, name) is None:
                raise KeyProblem(
                    f"{key}.{name}",
                    "must be given",
                    allowed="a number > 0, or no keys at all: the initial state there",
                )
        return _updated(side, velocity=_vector(f"{key}.velocity", side.velocity, d, 0.0, "velocity"))
    return side


def _vector(key: str, value: Vector | None, entries: int, default: float, what: str) -> Vector:
    """A vector of so many entries, or the default in each."""
    if value is None:
        return (default,) * entries
    if len(value) != entries:
        raise KeyProblem(
            key,
            "wrong number of entries",
            value,
            f"{entries}, one per {what} dimension" if entries else "none",
        )
    return value


_COLLISION_KEYS = {
    "none": (),
    "es-bgk": ("knudsen", "prandtl", "relaxation", "cross_section"),
    "granular-es-bgk": ("knudsen", "restitution", "prandtl", "relaxation", "cross_section"),
    "boltzmann": ("knudsen", "restitution", "cross_section", "exponent", "method", "penalise", "coarse"),
}


def _resolve_collision(given: Collision, d: int) -> Collision:
    operator = given.operator
    used = _COLLISION_KEYS[operator]
    for name in Collision.model_fields:
        value = getattr(given, name)
        if name == "operator" or value is None or name in used:
            continue
        if name == "restitution" and value == 1.0:
            continue
        hint = "granular-es-bgk" if name == "restitution" and operator == "es-bgk" else ""
        raise KeyProblem(
            f"collision.{name}", f'not used by "{operator}"', value, ", ".join(("operator", *used)), hint
        )
    for name in ("knudsen", "restitution"):
        if name in used and getattr(given, name) is None:
            raise KeyProblem(
                f"collision.{name}", "must be given", allowed=Collision.model_fields[name].description or ""
            )
    if operator == "none":
        return Collision(operator="none")
    cross_section = given.cross_section or (0.25 if d == 3 else 1.0)
    if operator == "boltzmann":
        exponent = 1.0 if given.exponent is None else given.exponent
        resolved = _updated(
            given, cross_section=cross_section, exponent=exponent, method=given.method or "direct",
            penalise=bool(given.penalise), coarse=bool(given.coarse),
        )
    else:
        exponent = 1.0
        resolved = _resolve_relaxation(given, cross_section, d)
    if operator == "es-bgk":
        resolved = _updated(resolved, restitution=None, cross_section=None)
    if not resolved.elastic:
        assert resolved.knudsen is not None and resolved.restitution is not None
        k_d = kinetic_theory.dissipation_coefficient(d, cross_section, exponent)
        resolved._cooling = (1.0 - resolved.restitution**2) * k_d / d / resolved.knudsen
        if not isfinite(resolved._cooling):
            raise KeyProblem("collision.knudsen", "too small: the cooling rate overflows", given.knudsen)
    return resolved


def _resolve_relaxation(given: Collision, cross_section: float, d: int) -> Collision:
    """Prandtl number and relaxation rate of the ES-BGK family; by default the hard spheres' own."""
    prandtl = _prandtl(given.prandtl, d)
    relaxation = given.relaxation
    if relaxation is not None and given.cross_section is not None and given.operator == "es-bgk":
        raise KeyProblem(
            "collision.cross_section",
            'not used by "es-bgk" beside collision.relaxation',
            given.cross_section,
            "one of the two",
        )
    if relaxation is None:
        if d == 1:
            raise KeyProblem(
                "collision.relaxation",
                "must be given in one velocity dimension: no viscosity fixes it",
                allowed="a table such as {coefficient = 1.0, density_power = 1, temperature_power = 0.5}",
            )
        relaxation = Relaxation(coefficient=kinetic_theory.hard_sphere_relaxation(d, cross_section, prandtl))
    assert given.knudsen is not None
    if not isfinite(relaxation.coefficient / given.knudsen):
        raise KeyProblem("collision.knudsen", "too small: the relaxation rate overflows", given.knudsen)
    return _updated(given, prandtl=prandtl, relaxation=relaxation, cross_section=cross_section)


def _prandtl(given: float | None, d: int) -> float:
    """The Prandtl number; nu = 1 - 1/Pr >= -1/(d-1), or the Gaussian does not exist."""
    smallest = (d - 1) / d if d > 1 else 1.0
    if given is None:
        return smallest
    if smallest * (1 - ROUNDED) <= given < smallest:
        return smallest
    if given < smallest or (d == 1 and given != 1.0):
        allowed = (
            "1 in one velocity dimension" if d == 1 else f"at least {d - 1}/{d} in {d} velocity dimensions"
        )
        raise KeyProblem("collision.prandtl", "no Gaussian with this Prandtl number exists", given, allowed)
    return given


def _resolve_time(time: Time) -> Time:
    if time.dt is None:
        return _updated(time, cfl=0.5 if time.cfl is None else time.cfl)
    if time.cfl is not None:
        raise KeyProblem("time.dt", "time.dt and time.cfl exclude each other", time.dt, "one of the two")
    if time.dt > time.end:
        raise KeyProblem("time.dt", "longer than the run", time.dt, f"at most time.end = {time.end}")
    return time


def _resolve_output(output: Output, end: float) -> Output:
    if output.every is not None:
        if output.times is not None:
            raise KeyProblem(
                "output.every", "output.times and output.every exclude each other", output.every, "one of the two"
            )
        return _updated(output, times=_times_every(output.every, end), every=None)
    if output.times is None:
        return _updated(output, times=(end,))
    times: Any = output.times
    if isinstance(times, SpacedTimes):
        times = _spaced_times(times, end)
    if max(times) > end:
        raise KeyProblem("output.times", "after the end", max(times), f"0 to time.end = {end}")
    if any(b <= a for a, b in pairwise(times)):
        raise KeyProblem("output.times", "not rising", times, "each time once, in rising order")
    return _updated(output, times=times)


def _times_every(every: float, end: float) -> tuple[float, ...]:
    """0, every, 2 every, ... and the end, as decimal numbers: 0.3 and not three times the binary 0.1."""
    if every > end:
        raise KeyProblem("output.every", "longer than the run", every, f"at most time.end = {end}")
    if end / every > MOST_SNAPSHOTS - 1:
        raise KeyProblem("output.every", f"more than {MOST_SNAPSHOTS} snapshots", every, "a longer time")
    step, last = Fraction(repr(every)), Fraction(repr(end))
    whole = int(last / step)
    if last - whole * step <= step / 10**9:  # the end itself, but for rounding
        whole -= 1
    return (*(float(k * step) for k in range(whole + 1)), end)


def _spaced_times(given: SpacedTimes, end: float) -> tuple[float, ...]:
    """So many times from one to another. Of those between twelve digits: the same numbers on every machine."""
    first, last = given.start, given.to
    if last > end:
        raise KeyProblem("output.times.to", "after the end", last, f"at most time.end = {end}")
    if not first < last:
        raise KeyProblem("output.times.from", "not below output.times.to", first, f"below {last}")
    if given.spacing == "log" and first == 0.0:
        raise KeyProblem("output.times.from", 'a logarithm has no 0 (spacing = "log")', first, "a number > 0")
    shares = [k / (given.count - 1) for k in range(1, given.count - 1)]
    if given.spacing == "log":
        between = [exp(log(first) + share * (log(last) - log(first))) for share in shares]
    else:
        between = [first + share * (last - first) for share in shares]
    times = (first, *(float(f"{time:.12g}") for time in between), last)
    if any(b <= a for a, b in pairwise(times)):
        raise KeyProblem("output.times.count", "too many for so short a span", given.count)
    return times


# --- initial states


def _needs_space(state: str, space: Space) -> None:
    if space.dimensions == 0:
        raise KeyProblem(
            "initial.state",
            f'"{state}" does not fit a problem without space',
            space.cells,
            "space.cells with 1 or 2 entries",
        )


def _inside(key: str, point: float, axis: int, space: Space) -> None:
    low, high = space.lower[axis], space.upper[axis]
    if not low < point < high:
        raise KeyProblem(key, "outside the domain", point, f"between {low} and {high}")


def _middle(space: Space) -> Vector:
    return tuple(0.5 * a + 0.5 * b for a, b in zip(space.lower, space.upper, strict=True))


def _resolve_uniform(state: Uniform, space: Space, d: int, collision: Collision) -> Uniform:
    velocity = _vector("initial.velocity", state.velocity, d, 0.0, "velocity")
    if state.stress is None:
        return _updated(
            state, velocity=velocity, temperature=1.0 if state.temperature is None else state.temperature
        )
    key, theta = "initial.stress", state.stress
    if len(theta) != d or any(len(row) != d for row in theta):
        raise KeyProblem(key, "wrong number of entries", theta, f"a list of {d} lists of {d} numbers")
    if any(theta[i][j] != theta[j][i] for i in range(d) for j in range(i)):
        raise KeyProblem(key, "not symmetric", theta, Uniform.model_fields["stress"].description or "")
    if not _positive_definite(theta):
        raise KeyProblem(
            key, "not positive definite", theta, Uniform.model_fields["stress"].description or ""
        )
    temperature = sum(theta[i][i] for i in range(d)) / d
    if state.temperature is not None and abs(state.temperature - temperature) > 1e-12 * temperature:
        raise KeyProblem(
            "initial.temperature",
            "is not the mean of the stress tensor's diagonal",
            state.temperature,
            f"{temperature}, or leave it out",
        )
    return _updated(state, velocity=velocity, temperature=temperature)


def _positive_definite(matrix: tuple[Vector, ...]) -> bool:
    """Whether every pivot of a symmetric matrix is positive."""
    rows = [list(row) for row in matrix]
    for k, pivot_row in enumerate(rows):
        if not pivot_row[k] > 0:
            return False
        for row in rows[k + 1 :]:
            factor = row[k] / pivot_row[k]
            row[:] = [a - factor * b for a, b in zip(row, pivot_row, strict=True)]
    return True


def _resolve_random(state: RandomDensity, space: Space, d: int, collision: Collision) -> RandomDensity:
    _needs_space(state.state, space)
    if not state.low < state.high:
        raise KeyProblem("initial.low", "not below initial.high", state.low, f"below {state.high}")
    if state.correlation_length > 0:
        low, high = max(space.length) / 350, min(space.length)
        if not low <= state.correlation_length <= high:
            raise KeyProblem(
                "initial.correlation_length",
                "out of range",
                state.correlation_length,
                f"0 (white noise per cell), or from {low:.4g} to {high:.4g} in this domain",
            )
    return state


def _resolve_disc(state: TemperatureDisc, space: Space, d: int, collision: Collision) -> TemperatureDisc:
    _needs_space(state.state, space)
    centre = _middle(space)
    if state.centre is not None:
        centre = _vector("initial.centre", state.centre, space.dimensions, 0.0, "space")
    for axis, coordinate in enumerate(centre):
        _inside("initial.centre", coordinate, axis, space)
    return _updated(state, centre=centre)


def _resolve_riemann(state: Riemann, space: Space, d: int, collision: Collision) -> Riemann:
    _needs_space(state.state, space)
    axis = AXES.index(state.direction)
    if axis >= space.dimensions:
        raise KeyProblem("initial.direction", "space has no such direction", state.direction, '"x"')
    position = _middle(space)[axis] if state.position is None else state.position
    _inside("initial.position", position, axis, space)
    sides = {
        name: _updated(side, velocity=_vector(f"initial.{name}.velocity", side.velocity, d, 0.0, "velocity"))
        for name, side in (("left", state.left), ("right", state.right))
    }
    return _updated(state, position=position, **sides)


def _resolve_wave(state: Wave, space: Space, d: int, collision: Collision) -> Wave:
    _needs_space(state.state, space)
    n = space.dimensions
    mode = (1.0, 0.0)[:n] if state.mode is None else _vector("initial.mode", state.mode, n, 0.0, "space")
    for axis, waves in enumerate(mode):
        step = 1.0 if space.periodic(axis) else 0.5
        if waves % step != 0.0:
            allowed = (
                "whole numbers where the boundary is periodic" if step == 1.0 else "whole and half numbers"
            )
            raise KeyProblem("initial.mode", f"does not fit the domain along {AXES[axis]}", mode, allowed)
        if abs(waves) > space.cells[axis] / 2:
            raise KeyProblem(
                "initial.mode", "too short a wave for the grid", mode, f"at most {space.cells[axis] / 2}"
            )
    for name in ("density", "temperature"):
        base, amplitude = getattr(state, name), getattr(state, f"{name}_amplitude")
        if not abs(amplitude) < base:
            raise KeyProblem(
                f"initial.{name}_amplitude",
                f"{name} would not stay positive",
                amplitude,
                f"below {base} in size",
            )
    return _updated(
        state,
        mode=mode,
        velocity=_vector("initial.velocity", state.velocity, d, 0.0, "velocity"),
        velocity_amplitude=_vector(
            "initial.velocity_amplitude", state.velocity_amplitude, d, 0.0, "velocity"
        ),
    )


def _resolve_from_run(state: FromRun, space: Space, d: int, collision: Collision) -> FromRun:
    # whether it is there is asked where a run starts from it: once it has, its checkpoints hold all of it
    return _updated(state, run=os.path.join(Path.cwd(), os.path.expanduser(state.run)))  # noqa: PTH111, PTH118


def check_source(job: Job, name: str, overrides: Iterable[str] = ()) -> None:
    """Refuse a job whose initial state is another run's if that run is not there.

    Parameters
    ----------
    job : Job
    name : str
        What the message begins with, such as the job file.
    overrides : iterable of str
        What was set on the command line, ``KEY=VALUE`` each.

    Raises
    ------
    JobError
        Naming the key and the directory.
    """
    state = job.initial
    if not isinstance(state, FromRun):
        return
    try:
        found, fields = Path(state.run).is_dir(), (Path(state.run) / "fields.h5").is_file()
    except (OSError, ValueError):
        found = fields = False
    if not fields:
        # the path in full, however long: it says where a relative one was looked for
        wrong = f"holds no run: {state.run} has no fields.h5" if found else f"no such directory: {state.run}"
        problem = KeyProblem("initial.run", wrong, allowed="the directory of a run")
        raise JobError(f"{name}: {problem.line(one.partition('=')[0].strip() for one in overrides)}")


def _resolve_two_gaussians(state: TwoGaussians, space: Space, d: int, collision: Collision) -> TwoGaussians:
    if collision.operator != "boltzmann":
        raise KeyProblem(
            "initial.state",
            f'"two-gaussians" does not fit the operator "{collision.operator}"',
            allowed='collision.operator = "boltzmann"',
        )
    if space.dimensions > 0 or d == 1:
        raise KeyProblem(
            "initial.state",
            '"two-gaussians" does not fit these dimensions',
            [space.dimensions, d],
            "no space and 2 or 3 velocity dimensions",
        )
    return state


def _resolve_bkw(state: Bkw, space: Space, d: int, collision: Collision) -> Bkw:
    if collision.operator != "boltzmann" or collision.exponent != 0.0 or not collision.elastic:
        raise KeyProblem(
            "initial.state",
            '"bkw" does not fit this collision operator',
            collision.operator,
            'collision.operator = "boltzmann" with exponent = 0 and restitution = 1',
        )
    if space.dimensions > 0 or d == 1:
        raise KeyProblem(
            "initial.state",
            '"bkw" does not fit these dimensions',
            [space.dimensions, d],
            "no space and 2 or 3 velocity dimensions",
        )
    return state


_RESOLVE_STATE: dict[type, Any] = {
    Uniform: _resolve_uniform,
    RandomDensity: _resolve_random,
    TemperatureDisc: _resolve_disc,
    Riemann: _resolve_riemann,
    Wave: _resolve_wave,
    FromRun: _resolve_from_run,
    TwoGaussians: _resolve_two_gaussians,
    Bkw: _resolve_bkw,
}
