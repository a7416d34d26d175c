"""The loop of a run: state -> step -> diagnostics -> output. Read this first.

    sim = Simulation(Job.from_file("my.toml"))
    for step in sim:
        ...

is one time step each; `run_job` is the same loop with a run directory around it.
"""

from __future__ import annotations

import bisect
import contextlib
import math
import os
import sys
import time as clock
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rvm_mpi import time_limits
from rvm_mpi.advice.accuracy import GridWatch
from rvm_mpi.advice.velocity_grid import check_sides
from rvm_mpi.compiling.declare import all_compiled
from rvm_mpi.exact_sum import exact_sums
from rvm_mpi.fluid import FluidSystem, PositivityLost
from rvm_mpi.grid.domain import Domain
from rvm_mpi.job.job import Job, JobError
from rvm_mpi.output import checkpoint, rundir
from rvm_mpi.output.checkpoint import Checkpoint
from rvm_mpi.output.results import DiskFailure
from rvm_mpi.run import postmortem
from rvm_mpi.run.control import Control
from rvm_mpi.run.failures import ENDED, on_rank_0
from rvm_mpi.run.launch import LaunchError, again, launched
from rvm_mpi.run.lock import Claim
from rvm_mpi.run.terminal import tell
from rvm_mpi.run.watch import Watch
from rvm_mpi.states import macroscopic_state
from rvm_mpi.step.failure import NumericalFailure
from rvm_mpi.step.stepper import KineticStepper, StepReport
from rvm_mpi.time_limits import COOLING, COURANT, Limit, Rates

InitialState = Callable[[np.ndarray, np.ndarray], tuple[Any, Any, Any]]


@dataclass(frozen=True)
class Step:
    """A finished time step: its number, the time it reached, its length, and which limit set that length."""

    number: int
    time: float
    dt: float
    limit: str


class Simulation:
    """A job in memory: its state, and the steps that advance it.

    Parameters
    ----------
    job : Job
    initial : callable, optional
        Takes cell centres x (1, nx) and y (ny, 1) and returns density, velocity (..., d) and temperature of f,
        broadcast over the cells; by default the job's own state.
    comm : MPI communicator, optional
        All ranks by default.
    restart : Checkpoint, optional
        Go on from there; the initial state is then the checkpoint's too.

    Attributes
    ----------
    time, number : float, int
        Where the run is.
    domain, kinetic, fluid
        The cells of this rank, g with its step, and the macroscopic system or None.

    Raises
    ------
    JobError
        On every rank, if the number of ranks, the initial state, a side's state or the checkpoint does not fit.
    NumericalFailure
        From iterating: the run cannot go on.
    """

    def __init__(
        self, job: Job, initial: InitialState | None = None, comm: Any = None, restart: Checkpoint | None = None
    ) -> None:
        check_sides(job)
        self.job = job
        self.domain = Domain(job, comm)
        if restart is not None:
            restart.check_job(job)
        density, velocity, tensor = self._initial = self._initial_state(initial, restart)
        d = job.velocity.dimensions
        temperature = np.trace(tensor, axis1=-2, axis2=-1) / d
        with_fluid = job.fluid.enabled or job.scaling.kind == "macroscopic"
        self.fluid = FluidSystem(job, self.domain) if with_fluid else None
        self.kinetic = KineticStepper(job, self.domain, density, velocity, tensor)
        if self.fluid is not None:
            self.fluid.set_state(density, velocity, temperature)
        self.time, self.number = 0.0, 0
        self.volume = math.prod(self.domain.spacing)
        self.stops = _stops(job)
        self.last_dt = 0.0
        # a stage of no length measures the rates that set the first step
        self.kinetic.first_stage(0.0)
        self.kinetic.measure_sides()
        self._set_rates()
        self.diagnostics = Diagnostics(self)
        if restart is not None:
            restart.fill(self.state(), self.domain)
            self._set_numbers(restart.numbers)

    def _initial_state(
        self, initial: InitialState | None, restart: Checkpoint | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        (i0, j0), (nx, ny) = self.domain.start, self.domain.local
        d = self.job.velocity.dimensions
        if restart is not None:
            cells = restart.cells(self.domain)
            density, velocity, tensor = (cells[f"initial_{name}"] for name in ("density", "velocity", "tensor"))
            return density[..., 0].copy(), velocity.copy(), tensor.reshape(ny, nx, d, d).copy()
        if initial is None:
            return macroscopic_state(self.job, i0, i0 + nx, j0, j0 + ny)
        dx, dy = self.domain.spacing
        lower = (*self.job.space.lower, 0.0, 0.0)
        x = lower[0] + (np.arange(i0, i0 + nx) + 0.5)[None, :] * dx
        y = lower[1] + (np.arange(j0, j0 + ny) + 0.5)[:, None] * dy
        density, velocity, temperature = initial(x, y)
        density = np.broadcast_to(np.asarray(density, dtype=float), (ny, nx)).copy()
        velocity = np.broadcast_to(np.asarray(velocity, dtype=float), (ny, nx, d)).copy()
        temperature = np.broadcast_to(np.asarray(temperature, dtype=float), (ny, nx))
        return density, velocity, temperature[..., None, None] * np.eye(d)

    # -- the loop -----------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Step]:
        while not self.finished:
            yield self.advance()

    @property
    def finished(self) -> bool:
        """Whether the end time or the last step is reached."""
        most = self.job.time.max_steps
        return self.time >= self.job.time.end or (most is not None and self.number >= most)

    def advance(self) -> Step:
        """One time step."""
        dt, limit = self._step_length()
        dt, reached = self._fit_to_stops(dt)
        if dt < time_limits.COLLAPSED * self.job.time.end and reached is None:
            raise self._collapse(dt, limit)
        saved = None if self.fluid is None else self.fluid.state.copy()
        while True:
            try:
                self._advance_fluid(dt)
                self.kinetic.first_stage(dt)
                shorter = time_limits.shorter_step(dt, self.kinetic.rate, self.job.time.cfl)
                if shorter is None:
                    report = self.kinetic.later_stages(dt)
                    break
            except (NumericalFailure, PositivityLost) as error:
                when = f"step {self.number + 1} from t = {self.time:.6g} with dt = {dt:.3g}"
                raise NumericalFailure(f"{error}; {when}", error.cell, getattr(error, "node", None), dt) from None
            # the scaling turned faster than the step before said: the first stage left g^n as it was
            dt, reached = shorter, None
            if self.fluid is not None and saved is not None:
                self.fluid.state[...] = saved
        self.time = self.time + dt if reached is None else reached
        self.number += 1
        self.last_dt = dt
        self._set_rates()
        self.diagnostics.update(report)
        return Step(self.number, self.time, dt, limit.name)

    def _set_rates(self) -> None:
        """The rates of the last stage, which set the next step."""
        if self.job.time.cfl is not None:
            self.kinetic.choose_share()
        self._rate, self._cooling_rate = self.kinetic.rate, self.kinetic.cooling_rate

    def _collapse(self, dt: float, limit: Limit) -> NumericalFailure:
        cell = None
        if limit in (COURANT, COOLING):
            cell = self.kinetic.fastest_cell(cooling=limit == COOLING)
        where = "" if cell is None else f" in {self.domain.place(cell)}"
        what = f"the time step has collapsed to {dt:.3g}, limited by {limit.name}{where}"
        return NumericalFailure(f"{what}; step {self.number + 1} from t = {self.time:.6g}", cell, dt=dt)

    def _step_length(self) -> tuple[float, Limit]:
        """The longest step allowed, and the limit that sets it."""
        time = self.job.time
        rates = Rates() if time.cfl is None else self._rates()
        return time_limits.step_length(time, rates, time.end - self.time)

    def _rates(self) -> Rates:
        """The rates that limit the next step; collective."""
        fluid = 0.0 if self.fluid is None else self.domain.maximum(self.fluid.max_rate())[0]
        return Rates(self._rate, self._cooling_rate, self.kinetic.collision_rate, fluid)

    def _fit_to_stops(self, dt: float) -> tuple[float, float | None]:
        """Shorten a step so that output times are hit exactly: the step, and the time to stop at if it reaches one."""
        coming = bisect.bisect_right(self.stops, self.time)
        stop = self.stops[coming] if coming < len(self.stops) else self.job.time.end
        dt, reached = time_limits.fit_to_stop(dt, stop - self.time, self.job.time.dt is not None)
        return dt, stop if reached else None

    def _advance_fluid(self, dt: float) -> None:
        """The fluid goes first: its omega at the end of the step gives the kinetic stages theirs."""
        if self.fluid is None:
            return
        self.fluid.advance(dt)
        scaling = self.job.scaling
        if scaling.kind == "macroscopic":
            if scaling.synchronise != 0.0:
                d = self.job.velocity.dimensions
                state, temperature = self.kinetic.macroscopic()
                self.fluid.synchronise(state[..., [*range(d + 1), 4]], temperature, dt)
            self.kinetic.set_scaling(self.fluid.omega(), dt)

    # -- checkpoints ------------------------------------------------------------------------------------------

    def state(self) -> checkpoint.State:
        """All that the next step depends on; the arrays are views of this simulation's own."""
        g, cells, sides = self.kinetic.state()
        if self.fluid is not None:
            cells["fluid"] = self.fluid.interior
        # far fields keep the initial state, and diagnostics are relative to it
        density, velocity, tensor = self._initial
        cells.update({"initial_density": density, "initial_velocity": velocity, "initial_tensor": tensor})
        numbers = {
            "time": self.time,
            "number": self.number,
            "last_dt": self.last_dt,
            "rate": self._rate,
            "drift_share": self.kinetic.share,
            "cooling_rate": self._cooling_rate,
            "diagnostics": self.diagnostics.numbers(),
        }
        return checkpoint.State(g, cells, sides, numbers)

    def _set_numbers(self, numbers: dict[str, Any]) -> None:
        self.time, self.number, self.last_dt = numbers["time"], numbers["number"], numbers["last_dt"]
        self._rate, self._cooling_rate = numbers["rate"], numbers["cooling_rate"]
        self.kinetic.share = numbers["drift_share"]
        self.diagnostics.set_numbers(numbers["diagnostics"])

    # -- what can be asked of the state ----------------------------------------------------------------

    def moments(self) -> dict[str, np.ndarray]:
        """Moments of f on this rank's cells (ny, nx, ...): density, velocity, temperature, heat_flux, two tensors.

        All are copies; stress is the temperature tensor Theta, pressure_tensor = density x stress (`moments.fields`).
        """
        return self.kinetic.fields()

    def snapshot(self) -> dict[str, np.ndarray]:
        """The datasets of `fields.h5` on this rank's cells; the arrays are the caller's own."""
        fields = {f"kinetic/{name}": values for name, values in self.kinetic.fields().items()}
        fields["scaling/omega"] = self.kinetic.omega.copy()
        if self.fluid is not None:
            density, velocity, temperature = self.fluid.moments()
            fields.update({"fluid/density": density, "fluid/velocity": velocity, "fluid/temperature": temperature})
        if self.job.output.marginals:
            fields["marginal/x"] = self.kinetic.marginal()
        return fields

    def walls(self) -> dict[str, np.ndarray]:
        """What each wall face of this rank receives, per area and time: means over the last step.

        Returns
        -------
        dict
            By name, for each wall `side` ("x-lower" and so on), over its n faces on this rank:

            wall/side/pressure : (n,) array
                Force on the wall per area along its outer normal, in units of density x speed^2.
            wall/side/shear_stress : (n, d) array
                Force on the wall per area along it, the same units; its normal component is 0.
            wall/side/heat_flux : (n,) array
                Heat that the wall receives, density x speed^3: the energy in its own frame, positive into the wall.
            wall/side/work : (n,) array
                Work that the gas does on the wall, force . velocity of the wall, the same units: negative where the
                wall drives the gas. heat_flux + work is the energy that leaves the gas.
        """
        d = self.job.velocity.dimensions
        found = {}
        for name, rates in self.kinetic.through.items():
            side = self.job.space.sides[name]
            if side.kind not in ("maxwell", "specular"):
                continue
            axis, sign = "xy".index(name[0]), (1.0 if name.endswith("upper") else -1.0)
            shear = sign * rates[:, 1 : 1 + d]
            shear[:, axis] = 0.0
            # no mass goes through it, and it moves along itself
            velocity = (0.0,) * d if side.velocity is None else side.velocity
            work = np.zeros(len(rates)) + sum(shear[:, q] * velocity[q] for q in range(d))
            found[f"wall/{name}/pressure"] = rates[:, 1 + axis].copy()
            found[f"wall/{name}/shear_stress"] = shear
            found[f"wall/{name}/heat_flux"] = sign * rates[:, 4] - work
            found[f"wall/{name}/work"] = work
        return found


def _stops(job: Job) -> list[float]:
    return sorted({float(t) for t in job.output.times if t > 0.0} | {float(job.time.end)})


class Diagnostics:
    """The row of `history.csv`, kept up to date after every step; the same on every rank, whatever their number.

    Sums over cells are exact (`exact_sum.py`); what entered and what was dissipated accumulates over the run.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._sim = simulation
        job = simulation.job
        d = self._d = job.velocity.dimensions
        sides = job.space.sides
        self._sides = [name for name, side in sides.items() if side.kind != "periodic"]
        self._parts = ["mass", *(f"momentum_{c}" for c in "xyz"[:d]), "energy"]
        self._entered = {f"entered_{part}_{name}": 0.0 for name in self._sides for part in self._parts}
        self._dissipated = 0.0
        self.row: dict[str, float] = {}
        self._first: dict[str, float] = {}
        self._measure(None)
        self._first = dict(self.row)
        omega0 = math.sqrt(2.0 * self.row["energy"] / (d * self.row["mass"]))
        self._momentum_scale = self.row["mass"] * omega0

    @property
    def columns(self) -> list[str]:
        """Names of the columns of `history.csv`."""
        return list(self.row)

    @property
    def first_rate(self) -> float:
        """Mean density times the square root of the mean temperature at the start."""
        volume = math.prod(self._sim.domain.cells) * self._sim.volume
        return self._first["mass"] / volume * math.sqrt(self._first["mean_temperature"])

    def numbers(self) -> dict[str, Any]:
        """What has accumulated, and what it is compared with: for a checkpoint."""
        return {
            "row": self.row,
            "first": self._first,
            "entered": dict(self._entered),
            "dissipated": self._dissipated,
            "momentum_scale": self._momentum_scale,
            "temperature_range": list(self.temperature_range),
        }

    def set_numbers(self, numbers: dict[str, Any]) -> None:
        """Go on with what `numbers` returned."""
        self.row, self._first, self._entered = numbers["row"], numbers["first"], numbers["entered"]
        self._dissipated, self._momentum_scale = numbers["dissipated"], numbers["momentum_scale"]
        self.temperature_range = (numbers["temperature_range"][0], numbers["temperature_range"][1])

    def update(self, report: StepReport) -> None:
        """Bring the row up to date with a finished step."""
        self._measure(report)

    def _measure(self, report: StepReport | None) -> None:
        sim, d = self._sim, self._d
        state, temperature = sim.kinetic.macroscopic()
        density = state[..., 0]
        picks = [0, *range(1, d + 1), 4]
        arrays = [state[..., q] for q in picks] + [density * temperature, density**2]
        fluid_density: np.ndarray = np.zeros(0)
        fluid_energy = fluid_thermal = fluid_density
        if sim.fluid is not None:
            fluid_density, fluid_energy = sim.fluid.interior[..., 0], sim.fluid.interior[..., -1]
            fluid_thermal = fluid_density * sim.fluid.moments()[2]
        arrays += [fluid_density, fluid_energy, fluid_thermal, fluid_density**2]
        arrays.append(np.zeros(0) if report is None else report.dissipated)
        cells = sim.domain.cells[0] * sim.domain.cells[1]
        mean = self._mean_density(density, cells)
        arrays.append(np.abs(density - mean))
        for name in self._sides:
            through = None if report is None else report.entered.get(name)
            arrays += [np.zeros(0) if through is None else through[:, q] for q in picks]
        sums = exact_sums(arrays, sim.domain.comm)
        *totals, heat, square, fluid_mass, fluid_energy_sum, fluid_heat, fluid_square = sums[: d + 8]
        dissipated, deviation = sums[d + 8 : d + 10]
        box = (report.box_mass, report.box_energy) if report else sim.kinetic.box_shares()
        on_grid = temperature / sim.kinetic.omega**2
        largest = sim.domain.maximum(
            -(report.smallest if report else float(self._interior_g().min()) * sim.kinetic.units.g),
            report.largest if report else float(self._interior_g().max()) * sim.kinetic.units.g,
            report.mismatch if report else 0.0,
            -float(temperature.min()),
            float(temperature.max()),
            *box,
            -float(on_grid.min()),
            float(on_grid.max()),
        )
        self.temperature_range = (-largest[3], largest[4])
        #: smallest and largest T_g
        self.grid_temperatures = (-largest[7], largest[8])
        replaced = exact_sums([np.array([float(report.replaced if report else 0)])], sim.domain.comm)[0]
        self._dissipated += float(dissipated) * sim.volume
        for key, value in zip(self._entered, sums[d + 10 :]):
            self._entered[key] += float(value) * sim.volume
        none = math.nan
        fluid = sim.fluid is not None
        row: dict[str, float] = {"step": sim.number, "time": sim.time, "dt": sim.last_dt}
        row.update({part: float(value) * sim.volume for part, value in zip(self._parts, totals)})
        row["fluid_energy"] = float(fluid_energy_sum) * sim.volume if fluid else none
        row["dissipated_energy"] = self._dissipated
        row.update(self._entered)
        row["mean_temperature"] = float(heat / totals[0])
        row["fluid_mean_temperature"] = float(fluid_heat / fluid_mass) if fluid else none
        row["density_variance"] = _variance(float(square) / cells, float(totals[0]) / cells)
        row["density_deviation"] = float(deviation) / cells
        fluid_variance = _variance(float(fluid_square) / cells, float(fluid_mass) / cells)
        row["fluid_density_variance"] = fluid_variance if fluid else none
        row["min_g"], row["max_g"], row["correction"] = -largest[0], largest[1], largest[2]
        row["gaussians_replaced"] = float(replaced)
        row["box_mass"], row["box_energy"] = largest[5], largest[6]
        row.update(self._balances(row))
        self.row = row

    def _mean_density(self, density: np.ndarray, cells: int) -> float:
        """That of the start."""
        if self._first:
            return self._first["mass"] / self._sim.volume / cells
        return float(exact_sums([density], self._sim.domain.comm)[0]) / cells

    def _balances(self, row: dict[str, float]) -> dict[str, float]:
        """What mass, momentum and energy miss, relative to their start (momentum: to mass times the initial omega)."""
        first = self._first or row
        gained = {part: sum(self._entered[f"entered_{part}_{name}"] for name in self._sides) for part in self._parts}
        mass = row["mass"] - first["mass"] - gained["mass"]
        energy = row["energy"] - first["energy"] - gained["energy"] + self._dissipated
        momentum = max(abs(row[part] - first[part] - gained[part]) for part in self._parts[1:-1])
        return {
            "mass_error": mass / first["mass"],
            "momentum_error": momentum / self._momentum_scale if self._first else 0.0,
            "energy_error": energy / first["energy"],
        }

    def _interior_g(self) -> np.ndarray:
        kinetic = self._sim.kinetic
        nx, ny = self._sim.domain.local
        wy, wx = kinetic.space.wy, kinetic.space.wx
        return kinetic.velocity_grid.unpack(kinetic.g[wy : wy + ny, wx : wx + nx])


def _variance(square: float, mean: float) -> float:
    """From the means of the squares and of the numbers."""
    return square - mean * mean


# -- a run in a directory ---------------------------------------------------------------------------------


def run_job(
    job: Job,
    output: Path,
    restart: bool = False,
    overwrite: bool = False,
    walltime: float | None = None,
    quiet: bool = False,
) -> int:
    """Run a job into a run directory.

    Parameters
    ----------
    job : Job
    output : Path
    restart, overwrite : bool
        Go on with the run that is there; move it aside.
    walltime : float, optional
        Stop with a checkpoint after so many seconds.
    quiet : bool
        Say nothing on the terminal; `run.log` has it all the same.

    Returns
    -------
    int
        0 done, 3 failed, 75 stopped early on purpose (go on with `--restart`).

    Raises
    ------
    JobError
        On every rank, before anything is written.
    """
    rundir.check(output, restart, overwrite)
    _check_same_on_all_ranks(job, output, restart, overwrite)
    if Path.cwd().is_relative_to(output.resolve()):
        output = output.resolve()  # "." goes with a directory that is moved aside
    if not quiet and launched().rank == 0 and not all_compiled():
        tell("compiling the kernels, kept for the next run: some seconds")
    with Control(output, walltime, job.output.checkpoint_every) as control:
        from mpi4py import MPI

        with Claim(output, MPI.COMM_WORLD) as claim:
            try:
                return _run_claimed(job, claim, control, restart, overwrite, quiet)
            except JobError:
                raise
            except Exception as error:
                claim.note(error)
                raise


def _run_claimed(job: Job, claim: Claim, control: Control, restart: bool, overwrite: bool, quiet: bool) -> int:
    simulation, lines = _resumed(job, claim.directory) if restart else (Simulation(job), [])
    try:
        opened = Run(simulation, claim, restart, overwrite, quiet)
    except DiskFailure as error:  # on every rank
        if simulation.domain.rank == 0:
            tell(f"rvm: {job.name}: {error}")
            rundir.Log.note_end(claim.directory, f"failed: {error}")
        return 3
    with opened as run:
        for line in lines:
            run.say(line)
        return run.go(control)


def _check_same_on_all_ranks(job: Job, output: Path, restart: bool, overwrite: bool) -> None:
    """LaunchError on every rank if they were given different runs, as the tasks of a farm are."""
    from mpi4py import MPI

    mine = (job.to_toml(), os.fspath(output), restart, overwrite)
    first = MPI.COMM_WORLD.bcast(mine)
    for rank, same in enumerate(MPI.COMM_WORLD.allgather(mine == first)):
        if not same:
            raise LaunchError(
                f"{job.name}: rank {rank} was given another job, directory or option than rank 0: the ranks of one run "
                "get the same, runs of their own are started one by one"
            )


def _resumed(job: Job, output: Path) -> tuple[Simulation, list[str]]:
    """The simulation at the newest checkpoint that is whole, and what there is to say about others."""
    from mpi4py import MPI

    return checkpoint.use_newest(output, MPI.COMM_WORLD, lambda found: Simulation(job, restart=found))


class Run:
    """A simulation with its run directory: snapshots, history, checkpoints, log."""

    def __init__(self, simulation: Simulation, claim: Claim, restart: bool, overwrite: bool, quiet: bool) -> None:
        from rvm_mpi.output.results import FieldsFile, History, Xdmf

        self.simulation = sim = simulation
        self.claim, self.comm = claim, sim.domain.comm
        self.output = output = claim.directory
        self.head = self.comm.rank == 0
        self.quiet = quiet
        self.log: rundir.Log | None = None
        self.history: History | None = None
        #: step of the last checkpoint
        self.saved: int | None = sim.number if restart else None
        job = sim.job
        if restart:
            on_rank_0(self.comm, self._check_restart)
        aside = on_rank_0(self.comm, lambda: rundir.prepare(output, job, restart, overwrite, claim.lock))
        self.watch = Watch(job)
        self.grid_watch = GridWatch(job)
        self.facts = facts = rundir.provenance(self.comm.size)
        on_rank_0(self.comm, lambda: self._open_log(facts, aside))
        self.fields = FieldsFile(
            output / "fields.h5",
            self.comm,
            sim.domain,
            job,
            facts,
            self._wall_layout(),
            sim.kinetic.marginal_nodes,
            resume=restart,
        )
        self.xdmf = on_rank_0(self.comm, lambda: Xdmf(output / "fields.xdmf", job, self.fields.stored))
        columns, done = sim.diagnostics.columns, sim.number if restart else None
        self.history = on_rank_0(self.comm, lambda: History(output / "history.csv", columns, done))
        if restart:
            self.say(f"restart from step {sim.number}, t = {sim.time:.6g}")

    def _check_restart(self) -> None:
        """Whether what was written before the checkpoint is there and fits; changes nothing."""
        from rvm_mpi.output.results import check_times, read_history

        sim = self.simulation
        end = sim.job.time.end
        if end < sim.time:
            raise JobError(f"{sim.job.name}: time.end = {end:g} lies before the checkpoint at t = {sim.time:g}")
        try:
            check_times(self.output / "fields.h5", sim.job, sim.time)
            history = read_history(self.output)
        except (OSError, KeyError, IndexError) as error:
            raise JobError(f"{self.output}: cannot go on with its results: {error}") from None
        if list(history) != sim.diagnostics.columns or sim.number not in history["step"]:
            raise JobError(f"{self.output / 'history.csv'}: it is not the history that leads to step {sim.number}")

    def __enter__(self) -> Run:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:  # else this rank may be alone with its error, and the others would not come to close it
            self.fields.close()
        for file in (self.history, self.log):
            if file is not None:
                file.close()

    def _open_log(self, facts: dict[str, str], aside: Path | None) -> None:
        self.log = rundir.Log(self.output / "run.log")
        for key, value in facts.items():
            self.log.write(f"{key}: {value}\n")
        if aside is not None:
            self.say(f"the run that was in {self.output} is now in {aside}")

    def say(self, line: str, failure: bool = False) -> None:
        """One line on rank 0's terminal and in `run.log`; `--quiet` does not keep a failure from the terminal."""
        if not self.head:
            return
        if self.log is not None:
            self.log.write(line + "\n")
        if failure or not self.quiet:
            tell(line)

    def _wall_layout(self) -> dict[str, Any]:
        from rvm_mpi.output.results import Layout

        sim, layout = self.simulation, {}
        nx, ny = sim.domain.cells
        d = sim.job.velocity.dimensions
        for name, side in sim.job.space.sides.items():
            if side.kind in ("maxwell", "specular"):
                n, axis = (ny, "y") if name[0] == "x" else (nx, "x")
                shape, axes = ((n,), (axis,)) if sim.domain.dimensions == 2 else ((1,), ("face",))
                what = f"the wall at {name}, mean over the last step"
                layout[f"wall/{name}/pressure"] = Layout(
                    shape, axes, f"pressure: force per area along the outer normal on {what}", "reference pressure"
                )
                layout[f"wall/{name}/shear_stress"] = Layout(
                    (*shape, d),
                    (*axes, "component"),
                    f"shear stress: force per area along the wall on {what}",
                    "reference pressure",
                )
                layout[f"wall/{name}/heat_flux"] = Layout(
                    shape,
                    axes,
                    f"heat per area and time, in the wall's own frame, positive into {what}",
                    "reference pressure x speed",
                )
                layout[f"wall/{name}/work"] = Layout(
                    shape,
                    axes,
                    "work per area and time that the gas does, shear stress . velocity of the wall, positive where "
                    f"the gas drives it, on {what}; heat_flux + work is the energy that leaves the gas",
                    "reference pressure x speed",
                )
        return layout

    def go(self, control: Control) -> int:
        """Step to the end, or to where the run is told to stop; the exit status."""
        from rvm_mpi.run.progress import Progress

        sim = self.simulation
        progress = None
        if self.head:
            stream = None if self.quiet else sys.stderr
            progress = Progress(
                sim.job, stream, self.log, self.comm.size, start_time=sim.time, start_step=sim.number,
                stretched=time_limits.stretched_time(sim.job, sim.diagnostics.first_rate),
            )  # fmt: skip
        stopped = ""
        try:
            if self.saved is None:
                self.record()
                self.warn()
            if sim.time not in self.fields.stored:  # else it was taken of this very state
                self.take_snapshot()
            control.start(8.0 * math.prod(sim.domain.cells) * sim.kinetic.grid.block)
            for step in sim:
                self.record()
                self.warn()
                if progress is not None:
                    row = sim.diagnostics.row
                    temperatures = sim.diagnostics.temperature_range
                    progress.update(step.number, step.time, step.dt, row["mass_error"], row["min_g"], temperatures)
                self.take_snapshot()
                if self.watch.reason_to_stop(sim.diagnostics.row):
                    return self.stop_at_the_box()
                decision = control.agree(sim.domain)
                if sim.finished:
                    break
                if decision.checkpoint:
                    self.save()
                    control.took_checkpoint()
                if decision.stop:
                    stopped = decision.stop
                    break
            if not stopped:
                self.take_last_snapshot()
                if self.saved != sim.number:
                    self.save()
        except NumericalFailure as error:
            return self._failed(f"{error}{self._last_healthy()}{self.examine(error)}")
        except DiskFailure as error:
            # what was moved away just then cannot be written either
            lost = self.claim.lost() if self.head else ""
            return self._failed(
                f"{lost}; step {sim.number}, t = {sim.time:.6g}" if lost else f"{error}{self._last_checkpoint()}"
            )
        if progress is not None:
            progress.close()
        if not stopped:
            self._note_end(f"done: step {sim.number}, t = {sim.time:.6g}")
            return 0
        if self.head:
            if self.claim.held():
                control.forget_stop_file()
            command = ["run", os.fspath(self.output / "job.toml"), "--output", os.fspath(self.output), "--restart"]
            said = (
                f"stopped by {stopped} after step {sim.number} at t = {sim.time:.6g}, with a checkpoint; "
                f"go on with: {again(command, self.comm.size)}"
            )
            self.say(f"rvm: {sim.job.name}: {said}")
            self._note_end(said)
        return 75

    def _failed(self, what: str) -> int:
        """Say why the run ends here; the exit status."""
        self.say(f"rvm: {self.simulation.job.name}: {what}", failure=True)
        self._note_end(f"failed: {what}")
        return 3

    def _note_end(self, how: str) -> None:
        if self.log is not None:
            self.log.write(f"{ENDED}{how}\n")

    def _last_checkpoint(self) -> str:
        return "" if self.saved is None else f"; the checkpoint of step {self.saved} is there for --restart"

    def _last_healthy(self) -> str:
        row = self.simulation.diagnostics.row
        return f"; last healthy: step {row['step']:.0f}, t = {row['time']:.6g}{self._last_checkpoint()}"

    def examine(self, failure: NumericalFailure) -> str:
        """Write the post-mortem; what to say about it."""
        found = postmortem.examine(self.simulation, failure)
        if not self.head:
            return ""
        if not self.claim.held():
            return "; no post-mortem is written: the directory is no longer this run's"
        more = {"versions": self.facts, "checkpoint_step": self.saved, "history": self._last_rows()}
        try:
            return f"; more in {postmortem.write(self.output, found, more)}"
        except OSError as error:  # what failed first is what counts
            return f"; no post-mortem could be written: {error.strerror}"

    def _last_rows(self) -> dict[str, Any]:
        from rvm_mpi.output.results import read_history

        try:
            return {name: column[-postmortem.ROWS :] for name, column in read_history(self.output).items()}
        except OSError:
            return {}

    def warn(self) -> None:
        """Say what the present row of the history has that a run should not have."""
        diagnostics = self.simulation.diagnostics
        lines = self.watch.warnings(diagnostics.row)
        lines += self.grid_watch.warnings(diagnostics.grid_temperatures, diagnostics.row)
        for line in lines:
            self.say(f"rvm: {self.simulation.job.name}: warning: {line}")

    def stop_at_the_box(self) -> int:
        """End a run whose gas leaves its velocity box, with a checkpoint; the exit status.

        It is that of a failure: a script that goes on with what stopped on purpose would come here again at once.
        """
        sim = self.simulation
        self.save()
        return self._failed(
            f"stopped after step {sim.number} at t = {sim.time:.6g}: "
            f"{self.watch.reason_to_stop(sim.diagnostics.row)}{self._last_checkpoint()} with another watch.box_stop; "
            "a wider velocity.half_width, with as many more velocity.points, needs a new run"
        )

    def save(self) -> None:
        """Write a checkpoint, once all that was written before it is on disk."""
        self.claim.check()
        sim = self.simulation
        files = [self.output / "fields.h5", *([self.output / "history.csv"] if self.head else [])]
        with checkpoint.agreed(sim.domain, self.output):
            for file in files:
                checkpoint.flush_to_disk(file)
        begin = clock.perf_counter()
        path = checkpoint.write(sim.state(), sim.domain, sim.job, self.output, sim.number)
        self.saved = sim.number
        seconds = clock.perf_counter() - begin
        if self.log is None:
            return
        with contextlib.suppress(FileNotFoundError):  # moved away just now: the next write notices
            size = path.stat().st_size / 1e6
            self.log.write(f"checkpoint of step {sim.number}, t = {sim.time:.6g}: {size:.1f} MB in {seconds:.2f} s\n")

    def record(self) -> None:
        """Append the present row to the history; DiskFailure on every rank if rank 0 cannot."""
        failed = ""
        if self.history is not None:
            try:
                self.history.append(self.simulation.diagnostics.row)
            except OSError as error:
                failed = str(error)
        if self.simulation.domain.maximum(float(failed != ""))[0] > 0.0:
            raise DiskFailure(self.comm.bcast(failed))

    def take_snapshot(self) -> None:
        """Write a snapshot if the present time is one of those wanted."""
        row = self._row(self.simulation.time)
        if row is not None:
            self._write_snapshot(row)

    def _row(self, time: float) -> int | None:
        """The place in `fields.h5` for a time; None if it has none."""
        row = bisect.bisect_left(self.fields.rows, time)
        return row if self.fields.rows[row : row + 1] == [time] else None

    def take_last_snapshot(self) -> None:
        """Where `max_steps` ends the run between two output times, write the end in the place of the next."""
        sim, fields = self.simulation, self.fields
        row = bisect.bisect_right(fields.rows, sim.time)
        if self._row(sim.time) is None and row < len(fields.rows) and math.isnan(fields.stored[row]):
            self._write_snapshot(row)

    def _write_snapshot(self, index: int) -> None:
        self.claim.check()
        sim = self.simulation
        i0, j0 = sim.domain.start
        nx, ny = sim.domain.local
        extra = {}
        for name, values in sim.walls().items():
            first, count = (j0, ny) if "/x-" in name else (i0, nx)
            extra[name] = ((slice(first, first + count),), values)
        self.fields.write(index, sim.time, sim.snapshot(), extra)
        on_rank_0(self.comm, lambda: self._describe(index))

    def _describe(self, index: int) -> None:
        if self.xdmf is not None:
            self.xdmf.add(index, self.simulation.time)
