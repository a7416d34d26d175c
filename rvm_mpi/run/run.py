"""A run in its directory: the loop of `simulation.py`, and after each step what is written, said and decided."""

from __future__ import annotations

import bisect
import contextlib
import math
import os
import sys
import time as clock
from pathlib import Path
from typing import Any

from rvm_mpi import time_limits
from rvm_mpi.advice.accuracy import GridWatch
from rvm_mpi.agree import DiskFailure, NotCompiled, agreed_on_disk, on_rank_0
from rvm_mpi.job.job import Job, JobError
from rvm_mpi.output import checkpoint, rundir
from rvm_mpi.output.fields import FieldsFile, check_times
from rvm_mpi.output.history import History
from rvm_mpi.output.layout import wall_layout
from rvm_mpi.output.read import read_history
from rvm_mpi.output.restart import use_newest
from rvm_mpi.output.xdmf import Xdmf
from rvm_mpi.run import postmortem
from rvm_mpi.run.claim import Claim
from rvm_mpi.run.control import Control
from rvm_mpi.run.launch import LaunchError, again, launched
from rvm_mpi.run.progress import Progress
from rvm_mpi.run.warm import prepare
from rvm_mpi.run.watch import Watch
from rvm_mpi.simulation import Simulation
from rvm_mpi.step.failure import NumericalFailure
from rvm_mpi.terminal import tell


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
    with Control(output, walltime, job.output.checkpoint_every) as control:
        from mpi4py import MPI

        with Claim(output, MPI.COMM_WORLD) as claim:
            try:
                prepare(MPI.COMM_WORLD, tell if launched().rank == 0 and not quiet else lambda _: None)
                return _run_claimed(job, claim, control, restart, overwrite, quiet)
            except (JobError, NotCompiled):
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

    return use_newest(output, MPI.COMM_WORLD, lambda found: Simulation(job, restart=found))


class Run:
    """A simulation with its run directory: snapshots, history, checkpoints, log."""

    def __init__(self, simulation: Simulation, claim: Claim, restart: bool, overwrite: bool, quiet: bool) -> None:
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
            wall_layout(job),
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

    def go(self, control: Control) -> int:
        """Step to the end, or to where the run is told to stop; the exit status."""
        sim = self.simulation
        progress = None
        if self.head:
            stream = None if self.quiet else sys.stderr
            progress = Progress(
                sim.job, stream, self.log, self.comm.size, start=(sim.number, sim.time),
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
            self.log.write(f"{rundir.ENDED}{how}\n")

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
        with agreed_on_disk(self.comm, f"{self.output} cannot be written"):
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
        on_rank_0(self.comm, self._append)

    def _append(self) -> None:
        if self.history is not None:
            self.history.append(self.simulation.diagnostics.row)

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
