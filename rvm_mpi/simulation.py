"""The loop of a run: state -> step -> diagnostics. Read this first.

    sim = Simulation(Job.from_file("my.toml"))
    for step in sim:
        ...

is one time step each; `run/run.py` is the same loop with a run directory around it.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from rvm_mpi import time_limits
from rvm_mpi.advice.velocity_grid import check_sides
from rvm_mpi.diagnostics import Diagnostics
from rvm_mpi.fluid import FluidSystem, PositivityLost
from rvm_mpi.grid.domain import Domain
from rvm_mpi.job.job import Job
from rvm_mpi.output.checkpoint import State
from rvm_mpi.output.restart import Checkpoint
from rvm_mpi.states import macroscopic_state
from rvm_mpi.step.failure import NumericalFailure
from rvm_mpi.step.stepper import KineticStepper
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
                if self.kinetic.too_long:
                    shorter = 0.5 * dt
                    if shorter < time_limits.COLLAPSED * self.job.time.end:
                        raise self._collapse(shorter, COURANT)
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

    def state(self) -> State:
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
        return State(g, cells, sides, numbers)

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
