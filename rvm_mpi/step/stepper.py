"""The time step of the kinetic equation: the stages of `scheme.py` one after the other, ghost cells before each.

The scaling is given from outside ("none", "macroscopic") or follows from the carried moments ("kinetic").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rvm_mpi import time_limits
from rvm_mpi.agree import raise_on_all
from rvm_mpi.collisions.penalised import ExplicitOperator
from rvm_mpi.grid.velocity import VelocityGrid
from rvm_mpi.job.job import JobError
from rvm_mpi.kinetic.moments import fields, sums_about
from rvm_mpi.kinetic.realisable import EXACT
from rvm_mpi.states import distribution
from rvm_mpi.step import fit, scheme
from rvm_mpi.step.data import (
    HEALTHY,
    NOT_POSITIVE,
    REPORT,
    Cells,
    Fields,
    Sides,
    Space,
    kernel_grid,
    lay_out,
    physics,
    work_space,
)
from rvm_mpi.step.failure import fail, first_cell
from rvm_mpi.step.ghosts import GHOSTS, SIDES, GhostCells, mirrors
from rvm_mpi.step.initial import Sampler, fill_gaussians
from rvm_mpi.step.relaxation import DEEPEST
from rvm_mpi.step.scheme import Stage
from rvm_mpi.step.sweep import sweep
from rvm_mpi.units import GasUnits

if TYPE_CHECKING:
    from rvm_mpi.grid.domain import Domain
    from rvm_mpi.job.job import Job


class Swept(NamedTuple):
    """A stage that was swept: which one, g and cells it read, g and cells it wrote."""

    stage: Stage
    g: np.ndarray
    out: np.ndarray
    begin: Cells
    new: Cells


@dataclass
class StepReport:
    """What a step leaves for the diagnostics; cell arrays are (ny, nx) of this rank.

    Attributes
    ----------
    smallest, largest : float
        Of g on this rank, in the job's units.
    mismatch : float
        The largest relative mismatch of a cell's moments that the correction removed, on this rank.
    replaced : int
        Cells (of this rank, over both stages) whose Gaussian had to take the nearest tensor the grid can hold.
    box_mass, box_energy : float
        The largest share, in size, of a cell's mass and energy in the outermost velocities, on this rank.
    dissipated : (ny, nx) array
        Energy per volume that collisions took during the step.
    entered : dict of side -> (n, 5) array
        Mass, momentum and energy per area (times 1/h of its direction) that entered through each face of a side.
    """

    smallest: float
    largest: float
    mismatch: float
    replaced: int
    box_mass: float
    box_energy: float
    dissipated: np.ndarray
    entered: dict[str, np.ndarray]


class KineticStepper:
    """g on this rank's cells and the two-stage step that advances it.

    Parameters
    ----------
    job : Job
    domain : Domain
    density, velocity, tensor : arrays (ny, nx), (ny, nx, d), (ny, nx, d, d)
        Initial state of f: its density, mean velocity and temperature tensor.
    integrator : tuple of Stage, optional
        The time integrator (`scheme.py`).

    Attributes
    ----------
    units : GasUnits
        What g and xi are kept in: times these they are in the job's. Where nothing is rescaled, omega is one unit of
        velocity in place of one.
    g : (ny + 2 wy, nx + 2 wx, block) array
        The rescaled distribution, ghost cells included.
    now : data.Cells
        omega, carried moments and sums that belong to g.
    rates : list of float
        Largest over all cells, in the last stage, of the sum of max|a|/h over the directions of space and, times each
        of `time_limits.DRIFT_SHARES`, over those of velocity.
    share : int
        Which of them sets the step.
    cooling_rate : float
        Largest over all cells of |d ln E/dt| by dissipation, in the last stage.
    too_long : bool
        Whether the first stage left a cell without thermal energy, which a shorter step does not.
    """

    def __init__(
        self,
        job: Job,
        domain: Domain,
        density: np.ndarray,
        velocity: np.ndarray,
        tensor: np.ndarray,
        integrator: tuple[Stage, ...] = scheme.HEUN,
    ) -> None:
        self.job, self.domain, self.integrator = job, domain, integrator
        self._refuse(fit.misfit(job, density, velocity, tensor, domain.start))
        hottest = np.trace(tensor, axis1=-2, axis2=-1).max() / job.velocity.dimensions
        largest = domain.maximum(float(density.max()), float(hottest))
        self.units = GasUnits.of(largest[0], largest[1], self.rescaled, job.velocity.dimensions)
        half_width = tuple(v / self.units.velocity for v in job.velocity.half_width)
        self.velocity_grid = VelocityGrid.create(job.velocity.points, half_width, self.units.density)
        self.grid = kernel_grid(self.velocity_grid, job.scheme.drift)
        self.model = physics(job)
        wy, wx = domain.ghosts(GHOSTS)
        nx, ny = domain.local
        per = [1.0 / h if q < domain.dimensions else 0.0 for q, h in enumerate(domain.spacing)]
        low_x, high_x, low_y, high_y = (domain.on_side(name) and not mirrors(job.space.sides[name]) for name in SIDES)
        stops = (low_x, high_x, low_y, high_y)
        self.space = Space(domain.dimensions, nx, ny, wx, wy, per[0], per[1], stops)
        self._buffer = work_space(self.grid, nx)
        self.work = lay_out.py_func(self.grid, nx, self._buffer)[0]
        copies = max(2, len(integrator))
        self.g, *self._others = (domain.empty(GHOSTS, self.grid.block, self.grid.guard) for _ in range(copies))
        self.now, *self._levels = (Cells.create(self.space) for _ in range(copies + 1))
        self._turned = np.zeros((ny, nx, 4))
        self._growth, self._depth = np.zeros((ny, nx)), np.zeros((ny, nx))
        self._omega_end = np.ones((ny, nx))
        self.report = np.zeros((ny, nx), dtype=REPORT)
        self._sides = Sides.create(nx, ny)
        self._through = tuple(np.zeros((n, 5)) for n in (ny, ny, nx, nx))
        initial = (density, velocity, tensor)
        self._ghosts = GhostCells(job, domain, initial, self.grid, self.space, self.model)
        self.rates, self.share, self.cooling_rate = [0.0] * len(time_limits.DRIFT_SHARES), 0, 0.0
        self.too_long = False
        self._operator = None
        self._source, self._heating = np.zeros((0, 0, self.grid.block)), np.zeros((ny, nx))
        if self.model.explicit:
            self._operator = ExplicitOperator(job, domain.comm, half_width[0], (ny, nx), self.grid.block)
            self._source, self._heating = self._operator.source, self._operator.heating
        self.last = Swept(integrator[0], self.g, self._others[0], self.now, self._levels[0])
        self._set(density, velocity, tensor)

    @property
    def rescaled(self) -> bool:
        """Whether omega differs from one."""
        return self.job.scaling.kind != "none"

    @property
    def omega(self) -> np.ndarray:
        """omega (ny, nx) on this rank's own cells: one where nothing is rescaled."""
        return self.inside(self.now.omega) / self.units.velocity

    def state(self) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
        """What the next step depends on, as views without ghosts: g, fields of the cells, rates through the sides."""
        wy, wx = self.domain.ghosts(GHOSTS)
        nx, ny = self.domain.local
        g = self.g[wy : wy + ny, wx : wx + nx]
        cells = {"omega": self.inside(self.now.omega), "sums": self.now.sums}
        if self.model.thermal:
            cells["mean"] = self.inside(self.now.mean)
        if self.model.carried:
            cells["carried"] = self.now.carried
        return g, cells, {name: self._through[SIDES.index(name)] for name in self._ghosts.states}

    def inside(self, array: np.ndarray) -> np.ndarray:
        """What an array with ghost cells holds of this rank's own cells: a view."""
        wy, wx = self.domain.ghosts(GHOSTS)
        nx, ny = self.domain.local
        return array[wy : wy + ny, wx : wx + nx]

    def _set(self, density: np.ndarray, velocity: np.ndarray, tensor: np.ndarray) -> None:
        """g of the initial state: the discrete Gaussian with its moments, in its own omega."""
        d, grid = self.grid.dimensions, self.grid
        speed2 = np.sum(velocity**2, axis=-1)
        trace = np.trace(tensor, axis1=-2, axis2=-1)
        state = fit.scaled(self.job, velocity, tensor, self.units.velocity)
        self.inside(self.now.omega)[...] = state.omega
        self._omega_end[...] = state.omega
        if self.model.thermal:
            self.inside(self.now.mean)[..., :d] = velocity
        status = np.zeros(density.shape, dtype=np.int64)
        sums = density / grid.weight
        fill_gaussians(
            self.g.reshape(-1), self.space, grid, sums, state.mean, state.tensor, status, self._buffer
        )
        failed = status.max() > EXACT
        self._refuse("velocity: the initial state does not fit the velocity grid; take more points" if failed else "")
        if distribution(self.job) is not None:
            sampler = Sampler(self.job, self.units)
            for j, i in np.ndindex(density.shape):
                cell = density[j, i], state.omega[j, i], state.mean[j, i], state.tensor[j, i]
                self.inside(self.g)[j, i] = sampler.block(*cell)[0]
        self.refresh_sums()
        carried = self.now.carried
        carried[..., 0] = density
        carried[..., 1 : 1 + d] = density[..., None] * velocity
        carried[..., 4] = 0.5 * density * (trace + speed2)

    def _refuse(self, problem: str) -> None:
        """JobError on every rank if any of them has found something, the same line on all; collective."""
        raise_on_all(self.domain.comm, JobError(f"{self.job.name}: {problem}") if problem else None)

    def refresh_sums(self) -> None:
        """Measure the sums of g over the nodes."""
        ny, nx = self.now.sums.shape[:2]
        self.now.sums[...] = sums_about(self.g, self.space, self.grid, np.zeros((ny, nx, 3)))[..., :10]

    def set_scaling(self, omega_end: np.ndarray, dt: float) -> None:
        """omega (ny, nx) at the end of the coming step, where it is given from outside; its rate is the step's mean."""
        self._omega_end[...] = omega_end
        if dt > 0.0:
            self._growth[...] = np.log(omega_end / self.omega) / dt

    def first_stage(self, dt: float) -> None:
        """The first stage from g^n, which stays as it is: with dt = 0 this only measures the rates.

        Raises
        ------
        NumericalFailure
            On every rank where a cell of any rank lost what it needs to go on.
        """
        for mean in self._through:
            mean[...] = 0.0
        self._replaced, self._mismatch = 0, 0.0
        self._dissipated = np.zeros(self.report.shape)
        self._run(self.integrator[0], dt, self.g, self._others[0], self.now, self._levels[0])

    def later_stages(self, dt: float) -> StepReport:
        """g^(n+1) from the first stage's result and g^n, written over g^n."""
        for stage in self.integrator[1:]:
            g, begin = self.last.out, self.last.new
            free = next(one for one in self._levels if one is not begin)
            if stage.final:
                self._run(stage, dt, g, self.g, begin, free)
            else:
                self._run(stage, dt, g, next(one for one in self._others if one is not g), begin, free)
        self._take_over()
        report = self.report
        entered = {
            name: (dt if name.endswith("lower") else -dt) * self._through[SIDES.index(name)]
            for name in SIDES
            if self.domain.on_side(name)
        }
        box_mass, box_energy = self.box_shares()
        return StepReport(
            smallest=float(report["smallest"].min()) * self.units.g,
            largest=float(report["largest"].max()) * self.units.g,
            mismatch=self._mismatch,
            replaced=self._replaced,
            box_mass=box_mass,
            box_energy=box_energy,
            dissipated=self._dissipated,
            entered=entered,
        )

    def _take_over(self) -> None:
        """The last result as the present state."""
        swept = self.last
        if swept.out is not self.g:  # of a single stage
            self._others[0], self.g = self.g, swept.out
        place = next(q for q, one in enumerate(self._levels) if one is swept.new)
        self._levels[place], self.now = self.now, swept.new

    def _run(self, stage: Stage, dt: float, g: np.ndarray, out: np.ndarray, begin: Cells, new: Cells) -> None:
        """One stage, and its part of what is reported of the step."""
        self.last = Swept(stage, g, out, begin, new)
        self._ghosts.fill(g, begin, self._sides)
        self._sweep(stage, dt)
        for q, mean in enumerate(self._through):
            mean += stage.share * self._sides.of(q)[0]
        self._replaced += int(self.report["replaced"].sum())
        self._mismatch = max(self._mismatch, float(self.report["mismatch"].max()))
        self._dissipated += self.report["dissipated"]

    def box_shares(self) -> tuple[float, float]:
        """The largest shares of mass and energy in the outermost velocities, over the cells of this rank.

        In size: where g is negative there, as linear reconstructions and the spectral operator can leave it, so is the
        share.
        """
        mass, energy = (np.abs(self.report[part]) for part in ("box_mass", "box_energy"))
        return float(mass.max()), float(energy.max())

    def measure_sides(self) -> None:
        """Take the rates through the physical sides from the last stage alone: at the start, before any step."""
        for q, mean in enumerate(self._through):
            mean[...] = self._sides.of(q)[0]

    @property
    def through(self) -> dict[str, np.ndarray]:
        """Mean rates of mass, momentum and energy of the last step through this rank's faces of physical sides.

        Per area, counted along +x and +y: arrays (n, 5).
        """
        spacing = {"x": self.domain.spacing[0], "y": self.domain.spacing[1]}
        return {
            name: self._through[SIDES.index(name)] * spacing[name[0]] for name in SIDES if self.domain.on_side(name)
        }

    @property
    def collision_rate(self) -> float:
        """One over the longest step of an explicit operator, the same on all ranks; else 0."""
        if self._operator is None:
            return 0.0
        state, temperature = self.macroscopic()
        rates = time_limits.collision_rate(self.job, state[..., 0], temperature, self.omega)
        return self.domain.maximum(float(rates.max()))[0]

    def _sweep(self, stage: Stage, dt: float) -> None:
        _, g, out, begin, new = self.last
        if self._operator is not None:
            if self.job.collision.penalise and stage.number == 0:
                state, temperature = self.macroscopic()
                limit = DEEPEST / dt if dt > 0.0 else math.inf
                self._depth[...] = dt * self._operator.set_penalty(state[..., 0], temperature, self.omega, limit)
            self._operator.collide(self, g, begin)
        fields = Fields(
            g=g.reshape(-1),
            old=self.g.reshape(-1),
            out=out.reshape(-1),
            start=self.now,
            begin=begin,
            new=new,
            growth=self._growth,
            omega_end=self._omega_end,
            turned=self._turned,
            depth=self._depth,
            source=self._source.reshape(-1),
            heating=self._heating,
            report=self.report,
            sides=self._sides,
        )
        sweep(self.grid, self.space, self.model, stage, dt, fields, self._buffer)
        rates = self.cell_rates().largest()
        cooling, status = float(self.report["cooling_rate"].max()), float(self.report["status"].max())
        if not (math.isfinite(rates[0]) and math.isfinite(cooling)):
            status = max(status, float(NOT_POSITIVE))
        *self.rates, self.cooling_rate, worst = self.domain.maximum(*rates, cooling, status)
        # where the thermal scaling's first stage took more energy from a cell than it had, g^n is still there
        self.too_long = self.model.thermal and stage.number == 0 and dt > 0.0 and worst == NOT_POSITIVE
        if worst > HEALTHY and not self.too_long:
            fail(self, int(worst))

    def cell_rates(self) -> time_limits.CellRates:
        """What the last stage measured."""
        drift = self.report["drift"]
        answering: np.ndarray = np.zeros(())
        if self._operator is not None and self.rescaled:
            across = 0.5 * sum(self.grid.points[: self.grid.dimensions])  # V/h in all directions
            answering = time_limits.answering_rate(self.report["cooling_rate"], drift, across)
        return time_limits.CellRates(self.report["transport"], drift, answering)

    @property
    def rate(self) -> float:
        """The rate that, times dt, is to be the Courant number of a step."""
        return self.rates[self.share]

    def choose_share(self) -> None:
        """Choose the share of the drift that the next step is made for, the one that takes least time; collective."""
        number = math.prod(self.domain.cells)
        self.share = time_limits.choose_share(self.rates, self.cell_rates(), number, self.domain.total)

    def fastest_cell(self, cooling: bool) -> tuple[int, int] | None:
        """The cell that limited the last step by transport and drift, or by cooling; collective."""
        share = time_limits.DRIFT_SHARES[self.share]
        column = self.report["cooling_rate"] if cooling else self.cell_rates().at(share)
        return first_cell(self.domain, np.argwhere(column == self.domain.maximum(float(column.max()))[0]))

    def fields(self) -> dict[str, np.ndarray]:
        """Moments of f on this rank's cells (`moments.fields`)."""
        frames = self.inside(self.now.omega), self.inside(self.now.mean)
        return fields(self.g, frames, self.now.sums, self.space, self.grid)

    def macroscopic(self) -> tuple[np.ndarray, np.ndarray]:
        """rho, rho u, E (ny, nx, 5) of f and its temperature (ny, nx): as carried, else from the sums of g."""
        d = self.grid.dimensions
        if self.model.conservative:
            state = self.now.carried
        else:
            sums, omega, weight = self.now.sums, self.inside(self.now.omega), self.grid.weight
            state = np.empty((*sums.shape[:2], 5))
            state[..., 0] = weight * sums[..., 0]
            state[..., 1:4] = weight * omega[..., None] * sums[..., 1:4]
            state[..., 4] = 0.5 * weight * omega**2 * (sums[..., 4] + sums[..., 7] + sums[..., 9])
        density = state[..., 0]
        thermal = state[..., 4] - 0.5 * np.sum(state[..., 1:4] ** 2, axis=-1) / density
        return state, 2.0 * thermal / (d * density)

    def marginal(self) -> np.ndarray:
        """First marginal of g: its integral over xi_y, xi_z, (ny, nx, points), at `marginal_nodes`."""
        nx, ny = self.domain.local
        wy, wx = self.domain.ghosts(GHOSTS)
        inner = self.velocity_grid.unpack(self.g[wy : wy + ny, wx : wx + nx])
        return inner.sum(axis=(-2, -1)) * (self.grid.weight / self.velocity_grid.spacing[0] / self.units.velocity)

    @property
    def marginal_nodes(self) -> np.ndarray:
        """xi_x of the nodes, (points,), in the job's units."""
        return self.velocity_grid.x * self.units.velocity
