"""What depends on more than one key of a job: checks, and the defaults that follow from other keys."""

from __future__ import annotations

from math import isfinite, prod
from typing import TYPE_CHECKING

from rvm_mpi.job.check_collision import resolve_collision
from rvm_mpi.job.check_initial import RESOLVE_STATE
from rvm_mpi.job.check_time import resolve_output, resolve_time
from rvm_mpi.job.schema import Boundaries, Boundary, Fluid, Sides, Space, Velocity, both_sides
from rvm_mpi.job.text import KeyProblem, shown
from rvm_mpi.job.updates import AXES, updated, vector

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

MOST_CELLS = 2**28
"""Cells in all: the small fields on them, up to five numbers a cell, stay within PETSc's 32-bit indices."""
MOST_VELOCITIES = 2**24


def resolve(job: Job) -> Job:
    """Check what depends on several keys and write the defaults out; KeyProblem for what does not fit."""
    d = job.velocity.dimensions
    velocity = _resolve_velocity(job.velocity)
    space = _resolve_space(job.space, d)
    collision = resolve_collision(job.collision, d)
    time = resolve_time(job.time)
    job = updated(
        job,
        space=space,
        velocity=velocity,
        collision=collision,
        fluid=_resolve_fluid(job.fluid, job.scaling.kind),
        time=time,
        output=resolve_output(job.output, time.end),
        initial=RESOLVE_STATE[type(job.initial)](job.initial, space, d, collision),
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
    if job.collision.explicit:
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
    if kind == "thermal" and job.scheme.drift != "maxwellian":
        raise KeyProblem(
            "scheme.drift", 'not used with scaling.kind = "thermal"', job.scheme.drift, '"maxwellian", the default'
        )
    if kind == "thermal" and not job.scheme.conservative:
        raise KeyProblem("scheme.conservative", "the thermal scaling needs the moments' correction", False, "true")
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
    return updated(fluid, enabled=needed if fluid.enabled is None else fluid.enabled)


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
    lower = vector("space.lower", space.lower, n, 0.0, "space")
    upper = vector("space.upper", space.upper, n, 1.0, "space")
    for low, high, cells in zip(lower, upper, space.cells, strict=True):
        if not low < high:
            raise KeyProblem(
                "space.upper", "not above space.lower", upper, f"above {shown(lower)} everywhere"
            )
        width = (high - low) / cells
        if not isfinite(high - low) or width < 1e-9 * max(abs(low), abs(high)) or width * width == 0.0:
            raise KeyProblem("space.upper", "cells too narrow or too wide for double precision", upper)
    return updated(space, lower=lower, upper=upper, boundary=_resolve_boundaries(space, d))


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
        velocity = vector(f"{key}.velocity", side.velocity, d, 0.0, "velocity")
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
        return updated(side, velocity=vector(f"{key}.velocity", side.velocity, d, 0.0, "velocity"))
    return side


