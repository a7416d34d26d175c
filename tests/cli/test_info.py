"""`rvm info` on whatever a run can leave behind: it never fails, it says what is missing."""

import os
import time
from datetime import datetime, timezone

import numpy as np

from rvm_mpi.commands.main import main
from rvm_mpi.job.job import Job
from rvm_mpi.output import rundir
from rvm_mpi.output.history import History

JOB = Job.from_dict(
    {
        "title": "a short run",
        "space": {"cells": [8]},
        "velocity": {"points": [8]},
        "collision": {"operator": "none"},
        "initial": {"state": "uniform"},
        "time": {"end": 2.0},
    }
)


def shown(path, capsys):
    assert main(["info", str(path)]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    return dict(line.split(None, 1) for line in captured.out.splitlines())


def test_a_run_that_has_only_begun(tmp_path, capsys):
    rundir.prepare(tmp_path, JOB)
    lines = shown(tmp_path, capsys)
    assert lines["job"] == "a short run: uniform, 8 cells, 8 velocities, none, scaling kinetic"
    assert lines["progress"].startswith("no history")
    assert lines["snapshots"].startswith("none")
    assert lines["checkpoints"] == "none"


def test_a_run_half_way(tmp_path, capsys):
    rundir.prepare(tmp_path, JOB)
    history = History(
        tmp_path / "history.csv", ["step", "time", "mass_error", "min_g", "max_g", "mean_temperature"]
    )
    for step, lowest in ((0, 0.0), (1, -1e-3), (2, 0.0)):
        row = {"step": step, "time": 0.5 * step, "mass_error": 1e-15 * step, "min_g": lowest, "max_g": 10.0}
        history.append({**row, "mean_temperature": 1.0 - 0.25 * step})
    history.close()
    (tmp_path / "checkpoint-000002.h5").write_bytes(b"")
    assert "post-mortem" not in shown(tmp_path, capsys)
    (tmp_path / "post-mortem.json").write_bytes(b"")
    lines = shown(tmp_path, capsys)
    assert lines["post-mortem"] == "post-mortem.json"
    assert lines["progress"] == "step 2, t = 1 of 2 (50.0 %)"
    assert "all numbers finite" in lines["health"]
    assert "mass error 2.0e-15" in lines["health"]
    assert "smallest g -1.0e-04 of the largest" in lines["health"]
    assert "mean temperature 1 to 0.5" in lines["health"]
    assert lines["checkpoints"] == "checkpoint-000002.h5"


def begun(path, *lines, age=0.0):
    """A run's log with these lines after its first ones, written `age` seconds ago."""
    path.mkdir(exist_ok=True)
    when = time.time() - age
    started = datetime.fromtimestamp(when - 10.0, timezone.utc).isoformat(timespec="seconds")
    (path / "run.log").write_text("\n".join(["version: 1", f"started: {started}", *lines]) + "\n")
    for file in path.iterdir():
        os.utime(file, (when, when))


def test_how_a_run_ended_is_what_it_said_last(tmp_path, capsys):
    begun(tmp_path, "ended: stopped by SIGTERM after step 3", "version: 1", "ended: done: step 9, t = 2")
    assert shown(tmp_path, capsys)["state"] == "done: step 9, t = 2"
    begun(tmp_path, "ended: stopped by SIGTERM after step 3", "version: 1", "restart from step 3", age=3600.0)
    assert shown(tmp_path, capsys)["state"].startswith("killed")
    assert "1:00 h" in shown(tmp_path, capsys)["state"]


def test_a_run_that_wrote_a_moment_ago_may_be_running(tmp_path, capsys):
    begun(tmp_path)
    assert shown(tmp_path, capsys)["state"].startswith("running, or just killed")


def test_columns_of_a_fluid_that_there_is_none_of_are_no_sickness(tmp_path, capsys):
    rundir.prepare(tmp_path, JOB.model_copy(update={"fluid": JOB.fluid.model_copy(update={"enabled": False})}))
    history = History(tmp_path / "history.csv", ["step", "time", "fluid_energy", "energy"])
    history.append({"step": 0, "time": 0.0, "fluid_energy": np.nan, "energy": 1.0})
    history.close()
    assert shown(tmp_path, capsys)["health"].startswith("all numbers finite")


def test_numbers_that_are_none_are_named(tmp_path, capsys):
    rundir.prepare(tmp_path, JOB)
    history = History(tmp_path / "history.csv", ["step", "time", "energy"])
    history.append({"step": 0, "time": 0.0, "energy": np.nan})
    history.close()
    assert "not a number in energy" in shown(tmp_path, capsys)["health"]


def test_broken_files_are_named(tmp_path, capsys):
    (tmp_path / "job.toml").write_text("[space")
    (tmp_path / "fields.h5").write_bytes(b"not HDF5")
    (tmp_path / "history.csv").write_text("")
    lines = shown(tmp_path, capsys)
    assert "not valid TOML" in lines["job"]
    assert lines["progress"].startswith("no")
    assert lines["snapshots"].startswith("none: ")
