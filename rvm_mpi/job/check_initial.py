"""Checks and defaults of `[initial]`: what a state needs of space, velocity and collisions."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rvm_mpi.job.initial import Bkw, FromRun, RandomDensity, Riemann, TemperatureDisc, TwoGaussians, Uniform, Wave
from rvm_mpi.job.schema import Collision, Space
from rvm_mpi.job.section import Vector
from rvm_mpi.job.text import JobError, KeyProblem
from rvm_mpi.job.updates import AXES, updated, vector

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job


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
    velocity = vector("initial.velocity", state.velocity, d, 0.0, "velocity")
    if state.stress is None:
        return updated(
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
    return updated(state, velocity=velocity, temperature=temperature)


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
        centre = vector("initial.centre", state.centre, space.dimensions, 0.0, "space")
    for axis, coordinate in enumerate(centre):
        _inside("initial.centre", coordinate, axis, space)
    return updated(state, centre=centre)


def _resolve_riemann(state: Riemann, space: Space, d: int, collision: Collision) -> Riemann:
    _needs_space(state.state, space)
    axis = AXES.index(state.direction)
    if axis >= space.dimensions:
        raise KeyProblem("initial.direction", "space has no such direction", state.direction, '"x"')
    position = _middle(space)[axis] if state.position is None else state.position
    _inside("initial.position", position, axis, space)
    sides = {
        name: updated(side, velocity=vector(f"initial.{name}.velocity", side.velocity, d, 0.0, "velocity"))
        for name, side in (("left", state.left), ("right", state.right))
    }
    return updated(state, position=position, **sides)


def _resolve_wave(state: Wave, space: Space, d: int, collision: Collision) -> Wave:
    _needs_space(state.state, space)
    n = space.dimensions
    mode = (1.0, 0.0)[:n] if state.mode is None else vector("initial.mode", state.mode, n, 0.0, "space")
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
    return updated(
        state,
        mode=mode,
        velocity=vector("initial.velocity", state.velocity, d, 0.0, "velocity"),
        velocity_amplitude=vector(
            "initial.velocity_amplitude", state.velocity_amplitude, d, 0.0, "velocity"
        ),
    )


def _resolve_from_run(state: FromRun, space: Space, d: int, collision: Collision) -> FromRun:
    # whether it is there is asked where a run starts from it: once it has, its checkpoints hold all of it
    return updated(state, run=os.path.join(Path.cwd(), os.path.expanduser(state.run)))  # noqa: PTH111, PTH118


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
    if not collision.explicit:
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
    if not collision.explicit or collision.exponent != 0.0 or not collision.elastic:
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


RESOLVE_STATE: dict[type, Any] = {
    Uniform: _resolve_uniform,
    RandomDensity: _resolve_random,
    TemperatureDisc: _resolve_disc,
    Riemann: _resolve_riemann,
    Wave: _resolve_wave,
    FromRun: _resolve_from_run,
    TwoGaussians: _resolve_two_gaussians,
    Bkw: _resolve_bkw,
}
"""For each initial state, what takes it, the space, d and the collisions, and returns it with its defaults."""
