"""What the columns of `diagnostics.py` are made of: what a rank has, and how that becomes one number for all."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from rvm_mpi.simulation import Simulation
    from rvm_mpi.step.stepper import StepReport


class Local:
    """What this rank has to measure after a step; arrays are (ny, nx) of its cells.

    Attributes
    ----------
    run : Simulation
    report : StepReport or None
        None at the start.
    state, density, temperature : arrays
        rho, rho u, E (ny, nx, 5) of f, the first of them, and its temperature.
    start_density : float
        Mean density of all cells at the start.
    """

    def __init__(self, run: Simulation, report: StepReport | None) -> None:
        self.run, self.report = run, report
        self.state, self.temperature = run.kinetic.macroscopic()
        self.density = self.state[..., 0]
        self.start_density = math.nan
        if run.fluid is not None:
            self.fluid_density, self.fluid_energy = run.fluid.interior[..., 0], run.fluid.interior[..., -1]

    def fluid_temperature(self) -> np.ndarray:
        """That of the macroscopic system."""
        assert self.run.fluid is not None
        return self.run.fluid.moments()[2]

    def grid_temperature(self) -> np.ndarray:
        """T_g, the temperature of g."""
        return self.temperature / self.run.kinetic.omega**2

    def entered(self, side: str, part: int) -> np.ndarray:
        """What entered through this rank's faces of a side in the step: entry `part` of `state`, over the volume."""
        through = None if self.report is None else self.report.entered.get(side)
        return np.zeros(0) if through is None else through[:, part]

    def extreme_g(self, which: str) -> float:
        """The "smallest" or "largest" value of g."""
        if self.report is not None:
            return float(getattr(self.report, which))
        kinetic = self.run.kinetic
        g = kinetic.velocity_grid.unpack(kinetic.inside(kinetic.g))
        return float(g.min() if which == "smallest" else g.max()) * kinetic.units.g

    def box_share(self, which: int) -> float:
        """The largest share of a cell's mass (0) or energy (1) in the outermost velocities."""
        report = self.report
        return (report.box_mass, report.box_energy)[which] if report else self.run.kinetic.box_shares()[which]

    def reported(self, name: str) -> float:
        """A number of the report, 0 at the start."""
        return 0.0 if self.report is None else float(getattr(self.report, name))


# -- how what the ranks have becomes one number -----------------------------------------------------------


class Whole(NamedTuple):
    """The domain: its number of cells, and the volume of each."""

    cells: int
    volume: float


class Sums(NamedTuple):
    """By exact sums over all cells of all ranks: of which arrays, and the number that follows from them."""

    words: str
    arrays: Callable[[Any], list[np.ndarray]]
    number: Callable[[Sequence[float], Whole], float]


class Extreme(NamedTuple):
    """By the largest (sign 1) or smallest (-1) number of any rank."""

    words: str
    sign: float


class Plain(NamedTuple):
    """A number that every rank has."""

    words: str


def _variance(sums: Sequence[float], whole: Whole) -> float:
    mean = float(sums[0]) / whole.cells
    return float(sums[1]) / whole.cells - mean * mean


INTEGRAL = Sums("integral", lambda a: [a], lambda sums, whole: float(sums[0]) * whole.volume)
RUNNING = Sums("integral, since the start", *INTEGRAL[1:])
MEAN = Sums("mean over the cells", lambda a: [a], lambda sums, whole: float(sums[0]) / whole.cells)
BY_MASS = Sums("mean by mass", lambda both: [both[0], both[0] * both[1]], lambda sums, _: float(sums[1] / sums[0]))
VARIANCE = Sums("variance over the cells", lambda a: [a, a**2], _variance)
NUMBER = Sums("sum", lambda count: [np.array([count])], lambda sums, _: float(sums[0]))
MAXIMUM, MINIMUM = Extreme("maximum", 1.0), Extreme("minimum", -1.0)
RUN, BALANCE = Plain("of the run"), Plain("from the columns before")
