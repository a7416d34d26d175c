"""One job in other units: its keys, and the factors by which its results must differ.

Used by `test_units.py`; docs/method.md, section 8, has the same rules in words.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from rvm_mpi import Job, Simulation
from rvm_mpi.job.job import JobError
from rvm_mpi.step.failure import NumericalFailure


class Units(NamedTuple):
    """What numbers of a density, a length and a speed are multiplied by. Exact where all are powers of two."""

    density: float = 1.0
    length: float = 1.0
    velocity: float = 1.0

    @property
    def time(self) -> float:
        return self.length / self.velocity

    @property
    def temperature(self) -> float:
        return self.velocity * self.velocity


def rescaled(job: Job, units: Units) -> Job:
    """The same problem in other units; every key of the job is written out, so no default stays behind."""
    tables = job.model_dump(exclude_none=True)
    tables["output"]["checkpoint_every"] = "10 min"
    _rescale_space(tables["space"], units)
    if job.scaling.kind == "none":
        tables["velocity"]["half_width"] = _times(job.velocity.half_width, units.velocity)
    if job.scaling.synchronise not in (0.0, "auto"):
        tables["scaling"]["synchronise"] = job.scaling.synchronise / units.time
    _rescale_collision(job, tables["collision"], units)
    tables["initial"] = _rescale_state(tables["initial"], units)
    tables["time"]["end"] *= units.time
    if job.time.dt is not None:
        tables["time"]["dt"] *= units.time
    tables["output"]["times"] = _times(job.output.times, units.time)
    return Job.from_dict(_lists(tables), name=job.name)


def _rescale_space(space: dict[str, Any], units: Units) -> None:
    for end in ("lower", "upper"):
        space[end] = _times(space[end], units.length)
    for both in space["boundary"].values():
        for side in both.values():
            side.update(_rescale_state({key: value for key, value in side.items() if key != "kind"}, units))


def _rescale_collision(job: Job, collision: dict[str, Any], units: Units) -> None:
    """Collisions a time: b rho |v|^exponent/knudsen, and coefficient rho^p T^q/knudsen beside it."""
    given = job.collision
    if given.operator == "none":
        return
    exponent = 1.0 if given.exponent is None else given.exponent
    collision["knudsen"] = given.knudsen * units.density * units.length * units.velocity ** (exponent - 1.0)
    if given.relaxation is not None:
        law = given.relaxation
        collision["relaxation"]["coefficient"] = (
            law.coefficient
            * units.density ** (1.0 - law.density_power)
            * units.velocity ** (1.0 - 2.0 * law.temperature_power)
        )


_DIMENSIONS = {
    "density": "density", "low": "density", "high": "density", "density_amplitude": "density",
    "velocity": "velocity", "velocity_amplitude": "velocity", "sigma": "velocity",
    "temperature": "temperature", "temperature_amplitude": "temperature", "stress": "temperature",
    "inner": "temperature", "outer": "temperature",
    "radius": "length", "centre": "length", "position": "length", "correlation_length": "length",
}  # fmt: skip


def _rescale_state(state: Mapping[str, Any], units: Units) -> dict[str, Any]:
    result = {}
    for key, value in state.items():
        if isinstance(value, Mapping):
            result[key] = _rescale_state(value, units)
        elif key in _DIMENSIONS:
            result[key] = _times(value, getattr(units, _DIMENSIONS[key]))
        else:
            result[key] = value
    return result


def _times(value: Any, factor: float) -> Any:
    return [_times(one, factor) for one in value] if isinstance(value, (list, tuple)) else value * factor


def _lists(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _lists(one) for key, one in value.items()}
    return [_lists(one) for one in value] if isinstance(value, (list, tuple)) else value


def factor(name: str, job: Job, units: Units) -> float:
    """By which a dataset of `fields.h5` or a column of `history.csv` differs in the other units."""
    density, length, velocity = units
    volume = length**job.space.dimensions
    area = length ** max(job.space.dimensions - 1, 0)
    rescaled_grid = job.scaling.kind != "none"
    g = density if rescaled_grid else density * velocity**-job.velocity.dimensions
    last = name.rpartition("/")[2]
    through = {"mass": density * velocity, "momentum": density * velocity**2, "energy": density * velocity**3}
    if last.startswith("entered_"):
        return through[last.split("_")[1]] * area * units.time
    if last.startswith("momentum_") and last != "momentum_error":
        return density * velocity * volume
    return {
        "time": units.time, "dt": units.time,
        "density": density, "temperature": velocity**2, "stress": velocity**2, "velocity": velocity,
        "heat_flux": density * velocity**3, "work": density * velocity**3, "pressure": density * velocity**2,
        "pressure_tensor": density * velocity**2, "shear_stress": density * velocity**2,
        "omega": velocity if rescaled_grid else 1.0, "x": density if rescaled_grid else density / velocity,
        "mass": density * volume, "energy": density * velocity**2 * volume,
        "fluid_energy": density * velocity**2 * volume, "dissipated_energy": density * velocity**2 * volume,
        "mean_temperature": velocity**2, "fluid_mean_temperature": velocity**2,
        "density_variance": density**2, "fluid_density_variance": density**2, "density_deviation": density,
        "min_g": g, "max_g": g,
    }.get(last, 1.0)  # fmt: skip


def results(job: Job, initial: Any = None, may_fail: bool = False) -> dict[str, np.ndarray]:
    """What a run leaves, in memory: each row of the history, and the fields and walls at the end.

    A run that may fail, or whose initial state may be refused, leaves the cell where it did, and all that was before.
    """
    try:
        simulation = Simulation(job, initial)
    except JobError:
        if not may_fail:
            raise
        return {"refused": np.ones(1)}
    rows, failure = [dict(simulation.diagnostics.row)], None
    try:
        for _ in simulation:
            rows.append(dict(simulation.diagnostics.row))
    except NumericalFailure as error:
        if not may_fail:
            raise
        failure = error
    found = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    if failure is not None:
        return {**found, "failed in": np.array(failure.cell or (-1, -1)), "dt": np.append(found["dt"], failure.dt)}
    found.update({name: np.array(values) for name, values in simulation.snapshot().items()})
    found.update({name: np.array(values) for name, values in simulation.walls().items()})
    return found
