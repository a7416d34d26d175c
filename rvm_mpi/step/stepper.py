"""The time integrator of the kinetic equation: two stages a step, ghost cells before each.

    g* = relax(g^n + dt L(g^n)),   g^(n+1) = relax(1/2 g^n + 1/2 (g* + dt L(g*)))

with L the transport and the total drift, and an implicit relaxation to the discrete Gaussian (`stage.py`,
docs/method.md). The scaling is given from outside ("none", "macroscopic") or follows from the carried
moments ("kinetic").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rvm_mpi import time_limits
from rvm_mpi.collisions.boltzmann import BoltzmannOperator
from rvm_mpi.collisions.es_bgk import EXACT, REPLACED, discrete_maxwellian
from rvm_mpi.collisions.weight_store import shared_weights
from rvm_mpi.compiling.declare import Direct, kernel
from rvm_mpi.compiling.simd import LANES, load, splat, total
from rvm_mpi.grid.velocity import VelocityGrid, Y, Z
from rvm_mpi.job.job import JobError
from rvm_mpi.kinetic.drift import reach
from rvm_mpi.kinetic.moments import fields, sums_about
from rvm_mpi.kinetic.walls import KINDS, Side, fill_side
from rvm_mpi.states import distribution
from rvm_mpi.step import fit
from rvm_mpi.step import sweep as stage
from rvm_mpi.step.initial import Sampler, fill_gaussians
from rvm_mpi.step.sweep import Cells, Model, Sides, Space, Work
from rvm_mpi.units import GasUnits, power

if TYPE_CHECKING:
    from rvm_mpi.grid.domain import Domain
    from rvm_mpi.job.job import Job

#: ghost cells of g: Van Leer's stencil reaches two cells
GHOSTS = 2
#: Courant number up to which Van Leer's limiter keeps g positive
POSITIVE = 0.5
SIDES = ("x-lower", "x-upper", "y-lower", "y-upper")
_PROBLEMS = {
    stage.TOO_COLD_FOR_GRID: "the velocity grid cannot hold the temperature: T_g is below what its spacing resolves",
    stage.NO_GAUSSIAN: "no Gaussian on the velocity grid has the moments wanted",
    stage.NO_CORRECTION: "g could not be corrected to its mass, momentum and energy",
    stage.NOT_POSITIVE: "density or temperature is not positive",
    stage.NOT_A_NUMBER: "g is not a number",
}


class NumericalFailure(RuntimeError):
    """The run cannot go on: what happened and where, in one line; the same on every rank.

    Attributes
    ----------
    cell : (i, j) or None
        Global indices of the cell, where there is one to name.
    node : tuple of int or None
        Indices of its first velocity that is no number.
    dt : float
        Length of the step that failed.
    """

    def __init__(
        self,
        message: str,
        cell: tuple[int, int] | None = None,
        node: tuple[int, ...] | None = None,
        dt: float = math.nan,
    ) -> None:
        super().__init__(message)
        self.cell, self.node, self.dt = cell, node, dt


class Sweep(NamedTuple):
    """The last stage that was swept: which one, g and cells it read, g and cells it wrote."""

    second: bool
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


@kernel
def _penalise(g, space, grid, sums, rate, work, block, source, small):  # type: ignore[no-untyped-def]
    """source -= rate (G[g] - g) in every cell, G the discrete Maxwellian with the sums (ny, nx, 10) of g."""
    moments, mean, tensor = small
    row = (space.nx + 2 * space.wx) * grid.block
    for j in range(space.ny):
        for i in range(space.nx):
            s = sums[j, i]
            speed2 = 0.0
            for q in range(3):
                mean[q] = s[1 + q] / s[0]
                speed2 += mean[q] ** 2
            temperature = ((s[4] + s[7] + s[9]) / s[0] - speed2) / grid.dimensions
            status = discrete_maxwellian(s[0], mean, temperature, grid, work, tensor, block, moments)
            cell = (j + space.wy) * row + (i + space.wx) * grid.block
            scale = s[0] / moments[0] if status <= REPLACED else math.nan
            for n in range(grid.block):
                source[j, i, n] -= rate[j, i] * (scale * block[n] - g[cell + n])


@kernel
def _heat(source, sums, nodes, slab, slab_size, factor, heating):  # type: ignore[no-untyped-def]
    """heating (ny, nx) = factor (ny, nx) sum |xi - u|^2 source, u the mean of g with the sums (ny, nx, 10)."""
    n = 0
    for j in range(heating.shape[0]):
        for i in range(heating.shape[1]):
            s = sums[j, i]
            ux, uy, uz = s[1] / s[0], s[2] / s[0], s[3] / s[0]
            square = splat(0.0)
            for x in range(nodes.size):
                along = (nodes[x] - ux) ** 2
                for m in range(0, slab_size, LANES):
                    cy, cz = load(slab, Y * slab_size + m) - uy, load(slab, Z * slab_size + m) - uz
                    square = square + load(source, n) * (cy * cy + cz * cz + along)
                    n += LANES
            heating[j, i] = factor[j, i] * total(square)


class KineticStepper:
    """g on this rank's cells and the two-stage step that advances it.

    Parameters
    ----------
    job : Job
    domain : Domain
    density, velocity, tensor : arrays (ny, nx), (ny, nx, d), (ny, nx, d, d)
        Initial state of f: its density, mean velocity and temperature tensor.

    Attributes
    ----------
    units : GasUnits
        What g and xi are kept in: times these they are in the job's. Where nothing is rescaled, omega is one unit of
        velocity in place of one.
    g : (ny + 2 wy, nx + 2 wx, block) array
        The rescaled distribution, ghost cells included.
    now : stage.Cells
        omega, carried moments and sums that belong to g.
    rates : list of float
        Largest over all cells, in the last stage, of the sum of max|a|/h over the directions of space and, times each
        of `time_limits.DRIFT_SHARES`, over those of velocity.
    share : int
        Which of them sets the step.
    cooling_rate : float
        Largest over all cells of |d ln E/dt| by dissipation, in the last stage.
    """

    def __init__(self, job: Job, domain: Domain, density: np.ndarray, velocity: np.ndarray, tensor: np.ndarray) -> None:
        self.job, self.domain = job, domain
        self._refuse(fit.misfit(job, density, velocity, tensor, domain.start))
        hottest = np.trace(tensor, axis1=-2, axis2=-1).max() / job.velocity.dimensions
        largest = domain.maximum(float(density.max()), float(hottest))
        self.units = GasUnits.of(largest[0], largest[1], self.rescaled, job.velocity.dimensions)
        half_width = tuple(v / self.units.velocity for v in job.velocity.half_width)
        self.velocity_grid = VelocityGrid.create(job.velocity.points, half_width, self.units.density)
        self.grid = stage.kernel_grid(self.velocity_grid, job.scheme.drift)
        self.model = _model(job)
        wy, wx = domain.ghosts(GHOSTS)
        nx, ny = domain.local
        per = [1.0 / h if q < domain.dimensions else 0.0 for q, h in enumerate(domain.spacing)]
        self.space = Space(domain.dimensions, nx, ny, wx, wy, per[0], per[1])
        self.work = Work.create(self.grid, nx)
        guard = reach.py_func(self.grid.points[2], self.grid.slab_size)
        self.g, self._other = (domain.empty(GHOSTS, self.grid.block, guard) for _ in range(2))
        self.now, self._middle, self._next = (self._cells() for _ in range(3))
        self._growth, self._depth = np.zeros((ny, nx)), np.zeros((ny, nx))
        self._omega_end = np.ones((ny, nx))
        self._diagnostics = np.zeros((ny, nx, stage.DIAGNOSTICS))
        self._sides = Sides.create(nx, ny)
        self._through = tuple(np.zeros((n, 5)) for n in (ny, ny, nx, nx))
        self._far = {name: self._side_states(name, density, velocity, tensor) for name in SIDES if domain.on_side(name)}
        self._run_sweep, self._fill_side = Direct(stage.sweep), Direct(fill_side)
        self._wall_work = np.zeros((5, self.grid.nodes.shape[1])), np.zeros(5)
        self.rates, self.share, self.cooling_rate = [0.0] * len(time_limits.DRIFT_SHARES), 0, 0.0
        self._operator = _operator(job, domain, half_width[0])
        self._source = np.zeros((ny, nx, self.grid.block)) if self._operator else np.zeros((0, 0, 0))
        self._heating, self._penalty = np.zeros((ny, nx)), np.zeros((ny, nx))
        self._slowing = np.ones((ny, nx))
        self.last = Sweep(False, self.g, self._other, self.now, self._middle)
        self._set(density, velocity, tensor)

    def _cells(self) -> Cells:
        nx, ny = self.domain.local
        wy, wx = self.domain.ghosts(GHOSTS)
        return Cells(np.ones((ny + 2 * wy, nx + 2 * wx)), np.zeros((ny, nx, 5)), np.zeros((ny, nx, 10)))

    @property
    def rescaled(self) -> bool:
        """Whether omega differs from one."""
        return self.job.scaling.kind != "none"

    @property
    def omega(self) -> np.ndarray:
        """omega (ny, nx) on this rank's own cells: one where nothing is rescaled."""
        return self._interior(self.now.omega) / self.units.velocity

    def state(self) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
        """What the next step depends on, as views without ghosts: g, fields of the cells, rates through the sides."""
        wy, wx = self.domain.ghosts(GHOSTS)
        nx, ny = self.domain.local
        g = self.g[wy : wy + ny, wx : wx + nx]
        cells = {"omega": self._interior(self.now.omega), "sums": self.now.sums}
        if self.model.kinetic or self.model.conservative:
            cells["carried"] = self.now.carried
        return g, cells, {name: self._through[SIDES.index(name)] for name in self._far}

    def _interior(self, array: np.ndarray) -> np.ndarray:
        wy, wx = self.domain.ghosts(GHOSTS)
        nx, ny = self.domain.local
        return array[wy : wy + ny, wx : wx + nx]

    def _set(self, density: np.ndarray, velocity: np.ndarray, tensor: np.ndarray) -> None:
        """g of the initial state: the discrete Gaussian with its moments, in its own omega."""
        d, grid = self.grid.dimensions, self.grid
        speed2 = np.sum(velocity**2, axis=-1)
        trace = np.trace(tensor, axis1=-2, axis2=-1)
        state = fit.scaled(self.job, velocity, tensor, self.units.velocity)
        self._interior(self.now.omega)[...] = state.omega
        self._omega_end[...] = state.omega
        status = np.zeros(density.shape, dtype=np.int64)
        fill_gaussians(
            self.g.reshape(-1),
            self.space,
            grid,
            density / grid.weight,
            state.mean,
            state.tensor,
            self.work.fit,
            self.work.gaussian,
            status,
            np.zeros(10),
        )
        failed = status.max() > EXACT
        self._refuse("velocity: the initial state does not fit the velocity grid; take more points" if failed else "")
        if distribution(self.job) is not None:
            sampler = Sampler(self.job, self.units)
            for j, i in np.ndindex(density.shape):
                cell = density[j, i], state.omega[j, i], state.mean[j, i], state.tensor[j, i]
                self._interior(self.g)[j, i] = sampler.block(*cell)[0]
        self.refresh_sums()
        carried = self.now.carried
        carried[..., 0] = density
        carried[..., 1 : 1 + d] = density[..., None] * velocity
        carried[..., 4] = 0.5 * density * (trace + speed2)

    def _refuse(self, problem: str) -> None:
        """JobError on every rank if any of them has found something, the same line on all; collective."""
        found = [one for one in self.domain.comm.allgather(problem) if one]
        if found:
            raise JobError(f"{self.job.name}: {found[0]}")

    def refresh_sums(self) -> None:
        """Measure the sums of g over the nodes."""
        ny, nx = self.now.sums.shape[:2]
        self.now.sums[...] = sums_about(self.g, self.space, self.grid, np.zeros((ny, nx, 3)))[..., :10]

    def _side_states(self, name: str, density: np.ndarray, velocity: np.ndarray, tensor: np.ndarray) -> np.ndarray:
        """rho, u, T of the wall or the far gas along a side: what the job says, else the initial state there."""
        d = self.grid.dimensions
        place = 0 if name.endswith("lower") else -1
        edge: Any = np.s_[:, place] if name[0] == "x" else np.s_[place, :]
        boundary = self.job.space.sides[name]
        states = np.zeros((density[edge].size, 5))
        states[:, 0] = density[edge]
        states[:, 1 : 1 + d] = velocity[edge]
        states[:, 4] = np.trace(tensor[edge], axis1=-2, axis2=-1) / d
        if boundary.density is not None:
            states[:, 0] = boundary.density
        if boundary.velocity is not None:
            states[:, 1 : 1 + d] = boundary.velocity
        if boundary.temperature is not None:
            states[:, 4] = boundary.temperature
        return states

    def _fill_ghosts(self, g: np.ndarray, cells: Cells) -> None:
        """Ghost cells of g and omega: from the neighbours, then what lies beyond the physical sides."""
        self.domain.exchange(g, GHOSTS)
        self.domain.exchange(cells.omega[..., None], GHOSTS)
        nx, ny = self.domain.local
        wy, wx = self.domain.ghosts(GHOSTS)
        block, row = self.grid.block, self.grid.block * (nx + 2 * self.space.wx)
        first = self.space.wy * row + self.space.wx * block
        carries = self.model.kinetic or self.model.conservative
        for name, states in self._far.items():
            axis, lower = "xy".index(name[0]), name.endswith("lower")
            boundary = self.job.space.sides[name]
            kind, accommodation = boundary.kind, boundary.accommodation
            if kind == "maxwell" and accommodation == 0.0:
                kind = "specular"
            # omega beyond a wall is that of the inner cell; a specular wall mirrors it like the gas
            field = cells.omega[wy : wy + ny].T if axis == 0 else cells.omega[:, wx : wx + nx]
            near, far, edge, next_one = (1, 0, 2, 3) if lower else (-2, -1, -3, -4)
            omega = field[edge].copy()
            field[near] = omega
            field[far] = field[next_one] if kind == "specular" else omega
            side = Side(
                inner=first if lower else first + ((nx - 1) * block if axis == 0 else (ny - 1) * row),
                along=(row, block)[axis],
                inward=(block, row)[axis] * (1 if lower else -1),
                axis=axis,
                sign=1 if lower else -1,
                kind=KINDS[kind],
                accommodation=1.0 if accommodation is None else float(accommodation),
                rate=(self.space.per_dx, self.space.per_dy)[axis] if carries else 0.0,
            )
            last = 0 if lower else -1
            sums = np.ascontiguousarray(cells.sums[:, last] if axis == 0 else cells.sums[last])
            beyond = self._sides.beyond[SIDES.index(name)]
            self._fill_side(g.reshape(-1), side, states, omega, sums, self.grid, *self._wall_work, beyond)

    def set_scaling(self, omega_end: np.ndarray, dt: float) -> None:
        """omega (ny, nx) at the end of the coming step, where it is given from outside; its rate is the step's mean."""
        self._omega_end[...] = omega_end
        if dt > 0.0:
            self._growth[...] = np.log(omega_end / self.omega) / dt

    def first_stage(self, dt: float) -> None:
        """g* from g^n, which stays as it is: with dt = 0 this only measures the rates.

        Raises
        ------
        NumericalFailure
            On every rank where a cell of any rank lost what it needs to go on.
        """
        self._fill_ghosts(self.g, self.now)
        self._sweep(False, dt, self.g, self._other, self.now, self._middle)

    def second_stage(self, dt: float) -> StepReport:
        """g^(n+1) from g* and g^n, written over g^n."""
        first = self._diagnostics.copy()
        for mean, side in zip(self._through, self._sides.through):
            mean[...] = side
        self._fill_ghosts(self._other, self._middle)
        self._sweep(True, dt, self._other, self.g, self._middle, self._next)
        self.now, self._next = self._next, self.now
        last = self._diagnostics
        for mean, side in zip(self._through, self._sides.through):
            mean[...] = 0.5 * (mean + side)
        entered = {
            name: (dt if name.endswith("lower") else -dt) * self._through[SIDES.index(name)]
            for name in SIDES
            if self.domain.on_side(name)
        }
        box_mass, box_energy = self.box_shares()
        return StepReport(
            smallest=float(last[..., stage.SMALLEST].min()) * self.units.g,
            largest=float(last[..., stage.LARGEST].max()) * self.units.g,
            mismatch=float(max(first[..., stage.MISMATCH].max(), last[..., stage.MISMATCH].max())),
            replaced=int((first[..., stage.GAUSSIANS_REPLACED] + last[..., stage.GAUSSIANS_REPLACED]).sum()),
            box_mass=box_mass,
            box_energy=box_energy,
            dissipated=first[..., stage.DISSIPATED] + last[..., stage.DISSIPATED],
            entered=entered,
        )

    def box_shares(self) -> tuple[float, float]:
        """The largest shares of mass and energy in the outermost velocities, over the cells of this rank.

        In size: where g is negative there, as linear reconstructions and the spectral operator can leave it, so is the
        share.
        """
        mass, energy = (np.abs(self._diagnostics[..., part]) for part in (stage.BOX_MASS, stage.BOX_ENERGY))
        return float(mass.max()), float(energy.max())

    def measure_sides(self) -> None:
        """Take the rates through the physical sides from the last stage alone: at the start, before any step."""
        for mean, side in zip(self._through, self._sides.through):
            mean[...] = side

    @property
    def through(self) -> dict[str, np.ndarray]:
        """Mean rates of mass, momentum and energy of the last step through this rank's faces of physical sides.

        Per area, counted along +x and +y: arrays (n, 5).
        """
        spacing = {"x": self.domain.spacing[0], "y": self.domain.spacing[1]}
        return {
            name: self._through[SIDES.index(name)] * spacing[name[0]] for name in SIDES if self.domain.on_side(name)
        }

    def _collide(self, g: np.ndarray, cells: Cells) -> None:
        """C[g] = omega^lambda Q(g, g)/eps of the explicit operator, and the rate of f's energy that belongs to it.

        What is carried leaves out the momentum, whose rate is spectral error alone, and an elastic gas's energy.
        """
        collision, grid = self.job.collision, self.velocity_grid
        assert self._operator is not None and collision.knudsen is not None and collision.exponent is not None
        ny, nx = self._heating.shape
        wy, wx = self.domain.ghosts(GHOSTS)
        # Q is quadratic in g: of the two units of density, one is that of the result
        scale = power(self._interior(cells.omega), collision.exponent) / collision.knudsen * self.units.density
        scale *= self._slowing
        values = grid.unpack(g[wy : wy + ny, wx : wx + nx]).reshape(ny, nx, *self.job.velocity.points)
        source = grid.unpack(self._source).reshape(values.shape)  # both are views
        self._operator.collide(values, source, scale)
        if collision.penalise:
            _penalise(
                g.reshape(-1), self.space, self.grid, cells.sums, self._penalty, self.work.fit, self.work.gaussian,
                self._source, (np.zeros(10), np.zeros(3), np.zeros(6)),
            )  # fmt: skip
        if collision.elastic:
            return
        factor = 0.5 * grid.weight * self._interior(cells.omega) ** 2
        _heat(self._source, cells.sums, grid.x, grid.slab, grid.slab_size, factor, self._heating)

    def _set_penalty(self, dt: float) -> None:
        """The rate of the relaxation that is taken off the operator and put back implicitly, for the coming step.

        Half of the fastest rate of the operator, so that what is left grows in no mode; the mean rate at the least.
        Where that is deeper than `stage.DEEPEST` operator and relaxation are slowed alike: it is the limit already.
        """
        state, temperature = self.macroscopic()
        density = state[..., 0]
        mean = time_limits.collision_frequency(self.job, density, temperature)
        rate = np.maximum(mean, 0.5 * time_limits.fastest_rate(self.job, density, self.omega))
        self._penalty[...] = np.minimum(rate, stage.DEEPEST / dt) if dt > 0.0 else rate
        self._slowing[...] = self._penalty / rate
        self._depth[...] = dt * self._penalty

    @property
    def collision_rate(self) -> float:
        """One over the longest step of an explicit operator, the same on all ranks; else 0."""
        if self._operator is None:
            return 0.0
        state, temperature = self.macroscopic()
        rates = time_limits.collision_rate(self.job, state[..., 0], temperature, self.omega)
        return self.domain.maximum(float(rates.max()))[0]

    def _sweep(self, second: bool, dt: float, g: np.ndarray, out: np.ndarray, begin: Cells, new: Cells) -> None:
        self.last = Sweep(second, g, out, begin, new)
        if self._operator is not None:
            if self.job.collision.penalise and not second:
                self._set_penalty(dt)
            self._collide(g, begin)
        self._run_sweep(*self._sweep_arguments(dt))
        local = self._diagnostics
        rates = self._cell_rates().largest()
        cooling, status = float(local[..., stage.COOLING_RATE].max()), float(local[..., stage.STATUS].max())
        if not (math.isfinite(rates[0]) and math.isfinite(cooling)):
            status = max(status, float(stage.NOT_POSITIVE))
        *self.rates, self.cooling_rate, worst = self.domain.maximum(*rates, cooling, status)
        if worst > stage.HEALTHY:
            self._fail(int(worst))

    def _sweep_arguments(self, dt: float) -> tuple[Any, ...]:
        """What `stage.sweep` takes for the stage that `last` says."""
        second, g, out, begin, new = self.last
        return (
            self.grid,
            self.space,
            self.model,
            second,
            dt,
            g.reshape(-1),
            out.reshape(-1),
            self.now,
            begin,
            new,
            self._growth,
            self._omega_end,
            self._depth,
            self._source.reshape(-1) if self._operator else None,
            self._heating,
            self._diagnostics,
            self._sides,
            self.work,
        )

    def _cell_rates(self) -> time_limits.CellRates:
        """What the last stage measured."""
        drift = self._diagnostics[..., stage.DRIFT]
        answering: np.ndarray = np.zeros(())
        if self._operator is not None and self.rescaled:
            across = 0.5 * sum(self.grid.points[: self.grid.dimensions])  # V/h in all directions
            answering = time_limits.answering_rate(self._diagnostics[..., stage.COOLING_RATE], drift, across)
        return time_limits.CellRates(self._diagnostics[..., stage.TRANSPORT], drift, answering)

    @property
    def rate(self) -> float:
        """The rate that, times dt, is to be the Courant number of a step."""
        return self.rates[self.share]

    def choose_share(self) -> None:
        """Choose the share of the drift that the next step is made for, the one that takes least time; collective."""
        number = math.prod(self.domain.cells)
        self.share = time_limits.choose_share(self.rates, self._cell_rates(), number, self.domain.total)

    def _fail(self, worst: int) -> None:
        """Name the first bad cell; every rank raises, the line is the same on all.

        What is no number spreads to the neighbours within the stage: the cell to name is the one that had it before.
        """
        sick = np.argwhere(~np.isfinite(self._interior(self.last.g)).all(axis=-1))
        cell = self.first_cell(sick)
        if cell is not None:
            worst = stage.NOT_A_NUMBER
        else:
            local = self._diagnostics
            cell = self.first_cell(np.argwhere(local[..., stage.STATUS] == worst))
            cell = cell or self.first_cell(np.argwhere(~np.isfinite(self._cell_rates().at(1.0))))
        node = self._sick_node(cell) if cell is not None and worst == stage.NOT_A_NUMBER else None
        where = "" if cell is None else f" in {self.domain.place(cell)}"
        if node is not None:
            where += f", velocity node ({', '.join(map(str, node))})"
        raise NumericalFailure(_PROBLEMS[worst] + where, cell, node)

    def first_cell(self, places: np.ndarray) -> tuple[int, int] | None:
        """The first (i, j) in the order of all cells of cells (j, i) that ranks have found; collective."""
        (i0, j0), nx = self.domain.start, self.domain.cells[0]
        mine = -min(((int(j) + j0) * nx + int(i) + i0 for j, i in places), default=math.inf)
        first = -self.domain.maximum(float(mine))[0]
        if not math.isfinite(first):
            return None
        j, i = divmod(int(first), nx)
        return i, j

    def fastest_cell(self, cooling: bool) -> tuple[int, int] | None:
        """The cell that limited the last step by transport and drift, or by cooling; collective."""
        share = time_limits.DRIFT_SHARES[self.share]
        column = self._diagnostics[..., stage.COOLING_RATE] if cooling else self._cell_rates().at(share)
        return self.first_cell(np.argwhere(column == self.domain.maximum(float(column.max()))[0]))

    def _sick_node(self, cell: tuple[int, int]) -> tuple[int, ...] | None:
        """Indices of the first velocity of a cell that is no number, before or after the stage; collective."""
        (i0, j0), (nx, ny) = self.domain.start, self.domain.local
        i, j = cell[0] - i0, cell[1] - j0
        found = -math.inf
        if 0 <= i < nx and 0 <= j < ny:
            for g in (self.last.g, self.last.out):
                sick = np.flatnonzero(~np.isfinite(self.velocity_grid.unpack(self._interior(g)[j, i])))
                if sick.size:
                    found = float(sick[0])
                    break
        found = self.domain.maximum(found)[0]
        if not math.isfinite(found):
            return None
        return tuple(int(k) for k in np.unravel_index(int(found), self.grid.points))[: self.grid.dimensions]

    def cell_report(self, i: int, j: int) -> dict[str, Any]:
        """What is known of cell (i, j) of this rank when a run fails: arrays and numbers by name.

        `start` is what the step began with, `stage` what the last stage read, `result` what it wrote, as far as it
        came; `sums` are those of 1, xi, xi xi times g over the nodes.
        """
        begin, new = self.last.begin, self.last.new
        report: dict[str, Any] = {
            "status": _PROBLEMS.get(int(self._diagnostics[j, i, stage.STATUS]), "healthy"),
            "transport_rate": float(self._diagnostics[j, i, stage.TRANSPORT]),
            "drift_rate": float(self._diagnostics[j, i, stage.DRIFT]),
            "cooling_rate": float(self._diagnostics[j, i, stage.COOLING_RATE]),
        }
        for name, cells in (("start", self.now), ("stage", begin), ("result", new)):
            speed = self.units.velocity
            xi = np.array([1.0, *[speed] * 3, *[speed * speed] * 6])
            omega = float(self._interior(cells.omega)[j, i]) / speed
            report[name] = {"omega": omega, "sums": cells.sums[j, i] * self.units.g * xi}
            if self.model.kinetic or self.model.conservative:
                report[name]["carried"] = cells.carried[j, i]
        return report

    def blocks(self, i: int, j: int) -> dict[str, np.ndarray]:
        """g of cell (i, j) of this rank that the last stage read and wrote, (points_x, points_y, points_z)."""
        return {
            name: self.velocity_grid.unpack(self._interior(g)[j, i]) * self.units.g
            for name, g in (("stage", self.last.g), ("result", self.last.out))
        }

    def fields(self) -> dict[str, np.ndarray]:
        """Moments of f on this rank's cells (`moments.fields`)."""
        return fields(self.g, self._interior(self.now.omega), self.now.sums, self.space, self.grid)

    def macroscopic(self) -> tuple[np.ndarray, np.ndarray]:
        """rho, rho u, E (ny, nx, 5) of f and its temperature (ny, nx): as carried, else from the sums of g."""
        d = self.grid.dimensions
        if self.model.conservative:
            state = self.now.carried
        else:
            sums, omega, weight = self.now.sums, self._interior(self.now.omega), self.grid.weight
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


def _model(job: Job) -> Model:
    """The job's physics as the numbers the kernels take."""
    collision = job.collision
    law, knudsen, prandtl = collision.relaxation, collision.knudsen, collision.prandtl
    collisions = bool(collision.penalise) or (law is not None and knudsen is not None)
    return Model(
        kinetic=job.scaling.kind == "kinetic",
        conservative=bool(job.scheme.conservative),
        collisions=collisions,
        nu=1.0 - 1.0 / prandtl if collisions and prandtl is not None else 0.0,
        relaxation=law.coefficient / knudsen if law is not None and knudsen is not None else 0.0,
        density_power=law.density_power if law is not None else 0.0,
        temperature_power=law.temperature_power if law is not None else 0.0,
        cooling=0.0 if collision.operator == "boltzmann" else collision.cooling,
        courant=job.time.cfl or POSITIVE,
    )


def _operator(job: Job, domain: Domain, half_width: float) -> BoltzmannOperator | None:
    """The job's explicit collision operator on a grid of this half width; its weights are the node's."""
    collision = job.collision
    if collision.operator != "boltzmann":
        return None
    assert collision.exponent is not None and collision.cross_section is not None
    points = tuple(job.velocity.points)
    restitution = 1.0 if collision.restitution is None else collision.restitution
    return BoltzmannOperator.create(
        points,
        half_width,
        restitution,
        collision.exponent,
        collision.cross_section,
        shared_weights(domain.comm, points, restitution, collision.exponent),
    )
