"""What a run directory holds, in words: the job, how far it got, what is stored, what made it, its health."""

from __future__ import annotations

import contextlib
import re
import time as clock
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import numpy as np

from rvm_mpi import diagnostics
from rvm_mpi.job.job import Job, JobError
from rvm_mpi.job.text import one_line
from rvm_mpi.output import lock as runlock
from rvm_mpi.output import rundir
from rvm_mpi.output.layout import stores_fluid
from rvm_mpi.output.read import open_run, read_history
from rvm_mpi.output.rundir import ENDED
from rvm_mpi.run.progress import duration

SHOWN_ATTRIBUTES = (
    "version", "git_commit", "started", "ranks", "machine", "python", "numpy", "numba", "mpi4py", "petsc4py",
    "h5py", "mpi", "petsc", "hdf5",
)  # fmt: skip


BEGUN, STARTED = "version: ", "started: "
"""First line of what a run writes into its log, and the one with its time."""
QUIET, PACE = 60.0, 10.0
"""A run is not taken for dead for so many seconds and so many of its steps' lengths."""


def describe_run(path: Path) -> Iterator[str]:
    """Lines on the run in a directory; whatever part of it is missing or broken is said to be."""
    job = None
    try:
        job = Job.from_file(path / "job.toml")
        yield _row("job", _job(job))
    except JobError as error:
        yield _row("job", str(error))
    yield _row("state", _state(path))
    yield from _lock_lines(path)
    yield from _history_lines(path, job)
    yield from _field_lines(path)
    names = [p.name for p in rundir.checkpoints(path)]
    yield _row("checkpoints", ", ".join(names) or "none")
    failures = sorted(path.glob("post-mortem*.json"))
    if failures:
        yield _row("post-mortem", ", ".join(p.name for p in failures))


def _row(name: str, text: str) -> str:
    return one_line(f"{name:<14}{text}")


def _state(path: Path) -> str:
    """Running, or how it ended: by its lock; where that cannot tell, by the last line of `run.log`, if it has one."""
    owner = _owner(path)
    alive = None if owner is None else owner.runs_here()
    if alive is not None:
        return "running" if alive else "killed: it has said no end, and its process is gone"
    try:
        text = "\n" + (path / "run.log").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return "unknown: it has no run.log"
    _before, found, last = text.rpartition(f"\n{BEGUN}")  # the last of the runs that went on here
    ends = [line for line in last.splitlines() if line.startswith(ENDED)]
    if ends:
        return ends[-1].removeprefix(ENDED)
    start = re.search(rf"^{STARTED}(.+)$", last, re.MULTILINE) if found else None
    quiet, usual = _silence(path, start[1] if start else "")
    if quiet > usual:
        return f"killed, or stands still: it has said no end, and written nothing for {duration(quiet)}"
    return f"running, or just killed: it has said no end, and last wrote something {duration(quiet)} ago"


def _silence(path: Path, started: str) -> tuple[float, float]:
    """Seconds since something was written in the run directory, and for how long that is usual at the run's pace."""
    last = max(file.stat().st_mtime for name in rundir.MARKS if (file := path / name).exists())
    begin, rows = last, 1
    with contextlib.suppress(OSError, ValueError):
        begin = datetime.fromisoformat(started).timestamp()
        rows = max((path / "history.csv").read_bytes().count(b"\n"), 1)
    return clock.time() - last, QUIET + PACE * max(last - begin, 0.0) / rows


def _owner(path: Path) -> runlock.Owner | None:
    """Who has the directory's lock, if anyone has."""
    try:
        return runlock.read(path / runlock.FILE)
    except OSError:
        return None


def _lock_lines(path: Path) -> Iterator[str]:
    """Whether a run is writing into the directory now."""
    owner = _owner(path)
    if owner is None:
        return
    alive = owner.runs_here()
    if alive is None:
        yield _row("lock", f"held by {owner.named()}; whether it is still there cannot be seen from here")
    elif alive:
        yield _row("running", f"now: {owner.named()}")
    else:
        yield _row("lock", f"left by {owner.named()}, which was killed; the next run takes the directory over")


def _job(job: Job) -> str:
    cells = " x ".join(map(str, job.space.cells)) or "no space"
    points = " x ".join(map(str, job.velocity.points))
    title = f"{job.title}: " if job.title else ""
    return (
        f"{title}{job.initial.state}, {cells} cells, {points} velocities, {job.collision.operator}, "
        f"scaling {job.scaling.kind}"
    )


def _history_lines(path: Path, job: Job | None) -> Iterator[str]:
    try:
        history = read_history(path)
    except (OSError, ValueError, IndexError) as error:
        yield _row("progress", f"no history: {error}")
        return
    rows = len(history["time"]) if "time" in history else 0
    if rows == 0:
        yield _row("progress", "no step yet")
        return
    time, step = float(history["time"][-1]), int(history["step"][-1])
    end = f" of {job.time.end:g} ({100 * time / job.time.end:.1f} %)" if job else ""
    yield _row("progress", f"step {step}, t = {time:.6g}{end}")
    yield _row("health", _health(history, job))


def _health(history: dict[str, np.ndarray], job: Job | None) -> str:
    """The worst of what the history records."""
    broken = [name for name, values in history.items() if not np.isfinite(values).all()]
    if job is None or not stores_fluid(job):  # its columns are then empty
        broken = [name for name in broken if not (_of_fluid(name) and np.isnan(history[name]).all())]
    words = [f"not a number in {', '.join(broken)}"] if broken else ["all numbers finite"]
    if "mass_error" in history:
        words.append(f"mass error {np.nanmax(np.abs(history['mass_error'])):.1e}")
    if {"min_g", "max_g"} <= history.keys():
        words.append(f"smallest g {np.nanmin(history['min_g'] / history['max_g']):.1e} of the largest")
    if "mean_temperature" in history:
        temperature = history["mean_temperature"]
        words.append(f"mean temperature {temperature[0]:.6g} to {temperature[-1]:.6g}")
    return "; ".join(words)


def _of_fluid(name: str) -> bool:
    column = diagnostics.column_named(name)
    return column is not None and column.fluid


def _field_lines(path: Path) -> Iterator[str]:
    try:
        fields = open_run(path)
    except (OSError, KeyError, ValueError) as error:
        yield _row("snapshots", f"none: {' '.join(str(error).split())}")
        return
    times = fields["time"].values
    listed = ", ".join(f"{time:g}" for time in times) or "none yet"
    yield _row("snapshots", f"{len(times)}: t = {listed}" if len(times) else listed)
    yield _row("fields", ", ".join(sorted(str(name) for name in fields.data_vars)))
    for name in SHOWN_ATTRIBUTES:
        if name in fields.attrs:
            yield _row(name, str(fields.attrs[name]))
