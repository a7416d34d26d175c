"""What is measured after each step: the columns of `history.csv`, each of them said here and nowhere else.

A row of `COLUMNS` says what a column is made of, how that becomes one number for all ranks, what it means, what
`rvm compare` takes its differences relative to, and whether a run watches it. To add a column, add a row (and write
`docs/history.md` anew: `python -m rvm_mpi.diagnostics > docs/history.md`).

Sums over cells are exact (`exact_sum.py`), so that a row does not depend on the number of ranks.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from itertools import groupby
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rvm_mpi.measure import (
    BALANCE,
    BY_MASS,
    INTEGRAL,
    MAXIMUM,
    MEAN,
    MINIMUM,
    NUMBER,
    RUN,
    RUNNING,
    VARIANCE,
    Extreme,
    Local,
    Plain,
    Sums,
    Whole,
)

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job
    from rvm_mpi.simulation import Simulation
    from rvm_mpi.step.stepper import StepReport

class Watched(NamedTuple):
    """What a run says when a column passes its threshold.

    Attributes
    ----------
    threshold : str
        Key of `[watch]`: "balance" or "box_warning".
    words : str
        With a place for the size.
    conservative : bool
        Kept to round-off only where the moments are carried and g is corrected to them (`scheme.conservative`).
    """

    threshold: str
    words: str
    conservative: bool = False


class Column(NamedTuple):
    """A column, or one for each {axis} of velocity and each {side} of the domain that is not periodic.

    Attributes
    ----------
    name : str
    how : Sums, Extreme or Plain
    of : callable
        What it is made of: takes a `Local` (and axis=, side=); for a balance the row so far and the first row.
    unit, meaning : str
    size : str
        What `rvm compare` takes differences relative to, beside the column's own largest number: another column,
        "momentum" (the root of mass times energy), "1" for what is relative already, "" for nothing else.
    watched : Watched, optional
    fluid : bool
        Empty (NaN) where the job has no macroscopic system.
    """

    name: str
    how: Sums | Extreme | Plain
    of: Callable[..., Any]
    unit: str
    meaning: str
    size: str = ""
    watched: Watched | None = None
    fluid: bool = False


def _gained(row: Mapping[str, float], part: str) -> float:
    return sum(value for name, value in row.items() if name.startswith(f"entered_{part}_"))


def _mass_error(row: Mapping[str, float], first: Mapping[str, float]) -> float:
    return (row["mass"] - first["mass"] - _gained(row, "mass")) / first["mass"]


def _momentum_error(row: Mapping[str, float], first: Mapping[str, float]) -> float:
    if row is first:
        return 0.0
    axes = [axis for axis in "xyz" if f"momentum_{axis}" in row]
    parts = [f"momentum_{axis}" for axis in axes]
    omega = math.sqrt(2.0 * first["energy"] / (len(axes) * first["mass"]))
    return max(abs(row[part] - first[part] - _gained(row, part)) for part in parts) / (first["mass"] * omega)


def _energy_error(row: Mapping[str, float], first: Mapping[str, float]) -> float:
    energy = row["energy"] - first["energy"] - _gained(row, "energy") + row["dissipated_energy"]
    return energy / first["energy"]


_OFF = "the balance of {} is off by {{:.2g}} of {} what came through the sides"
_BOX = "the outermost velocities hold {{:.2g}} of some cell's {}"
_MASS, _MOMENTUM, _ENERGY = "density x volume", "density x speed x volume", "density x speed^2 x volume"

COLUMNS = (
    Column("step", RUN, lambda here: here.run.number, "1", "number of the time step"),
    Column("time", RUN, lambda here: here.run.time, "length / speed", "time that it reached"),
    Column("dt", RUN, lambda here: here.run.last_dt, "length / speed", "its length"),
    Column("mass", INTEGRAL, lambda here: here.density, _MASS, "mass of f"),
    Column(
        "momentum_{axis}", INTEGRAL, lambda here, axis: here.state[..., 1 + "xyz".index(axis)], _MOMENTUM,
        "momentum of f along each velocity direction", size="momentum",
    ),
    Column("energy", INTEGRAL, lambda here: here.state[..., 4], _ENERGY, "energy of f, that of its mean flow included"),
    Column(
        "fluid_energy", INTEGRAL, lambda here: here.fluid_energy, _ENERGY, "energy of the macroscopic system",
        fluid=True,
    ),
    Column(
        "dissipated_energy", RUNNING,
        lambda here: np.zeros(0) if here.report is None else here.report.dissipated, _ENERGY,
        "energy that collisions took", size="energy",
    ),
    Column(
        "entered_mass_{side}", RUNNING, lambda here, side: here.entered(side, 0), _MASS,
        "mass that entered through each side that is not periodic", size="mass",
    ),
    Column(
        "entered_momentum_{axis}_{side}", RUNNING,
        lambda here, axis, side: here.entered(side, 1 + "xyz".index(axis)), _MOMENTUM,
        "momentum that entered there", size="momentum",
    ),
    Column(
        "entered_energy_{side}", RUNNING, lambda here, side: here.entered(side, 4), _ENERGY,
        "energy that entered there", size="energy",
    ),
    Column(
        "mean_temperature", BY_MASS, lambda here: (here.density, here.temperature), "temperature",
        "sum of rho T over the sum of rho, of f",
    ),
    Column(
        "fluid_mean_temperature", BY_MASS, lambda here: (here.fluid_density, here.fluid_temperature()), "temperature",
        "the same of the macroscopic system", fluid=True,
    ),
    Column("density_variance", VARIANCE, lambda here: here.density, "density^2", "variance of the density of f"),
    Column(
        "density_deviation", MEAN, lambda here: np.abs(here.density - here.start_density), "density",
        "mean size of the density's distance from its mean at the start",
    ),
    Column(
        "fluid_density_variance", VARIANCE, lambda here: here.fluid_density, "density^2",
        "variance of the macroscopic system's density", fluid=True,
    ),
    Column(
        "min_g", MINIMUM, lambda here: here.extreme_g("smallest"), "of g", "smallest value of g", size="max_g"
    ),
    Column("max_g", MAXIMUM, lambda here: here.extreme_g("largest"), "of g", "largest value of g"),
    Column(
        "correction", MAXIMUM, lambda here: here.reported("mismatch"), "1",
        "largest relative mismatch of a cell's moments that the correction of g removed", size="1",
    ),
    Column(
        "gaussians_replaced", NUMBER, lambda here: here.reported("replaced"), "1",
        "cells, over both stages, whose Gaussian took the nearest tensor that the velocity grid can hold",
    ),
    Column(
        "box_mass", MAXIMUM, lambda here: here.box_share(0), "1",
        "largest share, in size, of a cell's mass in the outermost layer of velocities", size="1",
        watched=Watched("box_warning", _BOX.format("mass")),
    ),
    Column(
        "box_energy", MAXIMUM, lambda here: here.box_share(1), "1", "the same of its energy", size="1",
        watched=Watched("box_warning", _BOX.format("energy")),
    ),
    Column(
        "mass_error", BALANCE, _mass_error, "1",
        "what mass misses since the start, with what entered counted, relative to the mass at the start", size="1",
        watched=Watched("balance", _OFF.format("mass", "what there was and")),
    ),
    Column(
        "momentum_error", BALANCE, _momentum_error, "1",
        "the same of momentum, the worst direction, relative to the mass times omega of the mean state at the start",
        size="1", watched=Watched("balance", _OFF.format("momentum", "mass times omega and"), conservative=True),
    ),
    Column(
        "energy_error", BALANCE, _energy_error, "1",
        "the same of energy, with what collisions took counted, relative to the energy at the start", size="1",
        watched=Watched("balance", _OFF.format("energy", "what there was and"), conservative=True),
    ),
)  # fmt: skip

BESIDE = (
    Column("min_temperature", MINIMUM, lambda here: float(here.temperature.min()), "temperature", ""),
    Column("max_temperature", MAXIMUM, lambda here: float(here.temperature.max()), "temperature", ""),
    Column("min_T_g", MINIMUM, lambda here: float(here.grid_temperature().min()), "temperature", ""),
    Column("max_T_g", MAXIMUM, lambda here: float(here.grid_temperature().max()), "temperature", ""),
)
"""Measured with them and not written: for the progress line and for warnings about the velocity grid."""


def columns_of(job: Job) -> list[Column]:
    """The columns of a job's history, in their order, each with its own name."""
    sides = [name for name, side in job.space.sides.items() if side.kind != "periodic"]
    axes = "xyz"[: job.velocity.dimensions]
    found = []
    for sided, group in groupby(COLUMNS, key=lambda column: "{side}" in column.name):
        templates = list(group)
        for side in sides if sided else [""]:
            for column in templates:
                for axis in axes if "{axis}" in column.name else [""]:
                    places = {key: value for key, value in (("axis", axis), ("side", side)) if value}
                    name = column.name.format(**places)
                    found.append(column._replace(name=name, of=partial(column.of, **places)))
    return found


@cache
def column_named(name: str) -> Column | None:
    """The row of the table that a column of some history belongs to; None if there is none."""
    for column in COLUMNS:
        if re.fullmatch(column.name.replace("{axis}", "[xyz]").replace("{side}", ".+"), name):
            return column
    return None


def natural_unit(name: str, largest: Mapping[str, float]) -> float:
    """The unit of a column that may be nought but for rounding, from the largest sizes of others; 0 if it has none."""
    column = column_named(name)
    size = "" if column is None else column.size
    if size == "momentum":
        return math.sqrt(largest.get("mass", 0.0) * largest.get("energy", 0.0))
    return 1.0 if size == "1" else largest.get(size, 0.0)


_HEAD = """# `history.csv`

For users who read or plot the history of a run. `python -m rvm_mpi.diagnostics` writes this page from the program.

One row for each time step, the first for the state at the start. Numbers read back as the same floats. Integrals are
over the domain; units are those of the job (`units.md`). Nothing here depends on the number of ranks or on how fast the
machine is: timings are in `run.log`. A column with {axis} or {side} is one for each velocity direction, or for each
side that is not periodic, such as `entered_momentum_x_y-lower`.
"""


def describe() -> Iterator[str]:
    """Lines of `docs/history.md`."""
    yield from _HEAD.split("\n")
    yield "| column | what | how | unit |"
    yield "| --- | --- | --- | --- |"
    for column in COLUMNS:
        meaning = column.meaning + ("; empty (nan) where the job has none" if column.fluid else "")
        yield f"| `{column.name}` | {meaning} | {column.how.words} | {column.unit} |"


# -- after each step --------------------------------------------------------------------------------------


class Diagnostics:
    """The row of `history.csv`, kept up to date after every step; the same on every rank, whatever their number.

    Parameters
    ----------
    simulation : Simulation
        At its start: what balances are relative to is measured now.

    Attributes
    ----------
    row : dict
        The latest numbers, by column.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._sim = simulation
        self._columns = columns_of(simulation.job)
        self._whole = Whole(math.prod(simulation.domain.cells), simulation.volume)
        self.row: dict[str, float] = {}
        self._beside: dict[str, float] = {}
        self._first: dict[str, float] = {}
        self._measure(None)
        self._first = self.row

    @property
    def columns(self) -> list[str]:
        """Names of the columns of `history.csv`."""
        return list(self.row)

    @property
    def first_rate(self) -> float:
        """Mean density times the square root of the mean temperature at the start."""
        volume = self._whole.cells * self._whole.volume
        return self._first["mass"] / volume * math.sqrt(self._first["mean_temperature"])

    @property
    def temperature_range(self) -> tuple[float, float]:
        """Smallest and largest temperature of a cell."""
        return self._beside["min_temperature"], self._beside["max_temperature"]

    @property
    def grid_temperatures(self) -> tuple[float, float]:
        """Smallest and largest T_g of a cell."""
        return self._beside["min_T_g"], self._beside["max_T_g"]

    def numbers(self) -> dict[str, Any]:
        """What has accumulated, and what it is compared with: for a checkpoint."""
        return {"row": self.row, "first": self._first, "temperature_range": list(self.temperature_range)}

    def set_numbers(self, numbers: dict[str, Any]) -> None:
        """Go on with what `numbers` returned."""
        self.row, self._first = numbers["row"], numbers["first"]
        self._beside["min_temperature"], self._beside["max_temperature"] = numbers["temperature_range"]

    def update(self, report: StepReport) -> None:
        """Bring the row up to date with a finished step; collective."""
        self._measure(report)

    def _measure(self, report: StepReport | None) -> None:
        here = Local(self._sim, report)
        here.start_density = self._start_density(here.density)
        columns = [*self._columns, *BESIDE]
        absent = {column.name for column in columns if column.fluid and self._sim.fluid is None}
        there = [column for column in columns if column.name not in absent]
        found = {**dict.fromkeys(absent, math.nan), **self._sums(there, here), **self._extremes(there, here)}
        row: dict[str, float] = {}
        for column in self._columns:
            if column.how is BALANCE:
                row[column.name] = column.of(row, self._first or row)
            elif column.how is RUN:
                row[column.name] = column.of(here)
            else:
                row[column.name] = found[column.name]
        self.row, self._beside = row, {column.name: found[column.name] for column in BESIDE}

    def _sums(self, columns: list[Column], here: Local) -> dict[str, float]:
        """Numbers of the columns that are sums, by one reduction: the same arrays in the same order on every rank."""
        from rvm_mpi.exact_sum import exact_sums  # kernels, which `rvm check` and `rvm compare` do without

        hows = {column: column.how for column in columns if isinstance(column.how, Sums)}
        parts = [how.arrays(column.of(here)) for column, how in hows.items()]
        sums = iter(exact_sums([array for part in parts for array in part], self._sim.domain.comm))
        found = {}
        for (column, how), part in zip(hows.items(), parts):
            found[column.name] = how.number([next(sums) for _ in part], self._whole)
            if how is RUNNING:
                found[column.name] += self.row.get(column.name, 0.0)
        return found

    def _extremes(self, columns: list[Column], here: Local) -> dict[str, float]:
        signs = {column: column.how.sign for column in columns if isinstance(column.how, Extreme)}
        largest = self._sim.domain.maximum(*(sign * column.of(here) for column, sign in signs.items()))
        return {column.name: sign * value for (column, sign), value in zip(signs.items(), largest)}

    def _start_density(self, density: np.ndarray) -> float:
        if self._first:
            return self._first["mass"] / self._whole.volume / self._whole.cells
        from rvm_mpi.exact_sum import exact_sums

        return float(exact_sums([density], self._sim.domain.comm)[0]) / self._whole.cells


if __name__ == "__main__":
    sys.stdout.write("\n".join(describe()) + "\n")
