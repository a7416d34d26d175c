"""Stopping and going on: the same bits as an undisturbed run, whatever the ranks and whatever stopped it."""

import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import h5py
import pytest
from conftest import mpi_environment, start_line
from small_runs import GRANULAR, job_text

from rvm_mpi.output.compare import compare_paths

PROGRAM = Path(__file__).with_name("restart_program.py")
PATIENCE = 400.0  # seconds: on a busy machine kernels may take minutes to compile the first time
SPACE = ["1d-macroscopic", "1d-unscaled", "1d-boltzmann", "2d-walls", "2d-macroscopic", "2d-kinetic"]

pytestmark = pytest.mark.timeout(3 * PATIENCE)


def assert_same(one, other, step):
    """Fields, history and the whole state at the end."""
    assert (one / "history.csv").read_bytes() == (other / "history.csv").read_bytes()
    name = f"checkpoint-{step:08d}.h5"
    for pair in ((one, other), (one / name, other / name)):
        same, lines = compare_paths(*pair)
        assert same, lines


@pytest.fixture(scope="module")
def runs(mpirun, tmp_path_factory):
    """Undisturbed runs and halves of them: in space on two ranks, without on one."""
    top = tmp_path_factory.mktemp("runs")
    for ranks, cases in ((2, SPACE), (1, ["0d"])):
        for what in ("whole", "half"):
            result = mpirun(ranks, PROGRAM, top, what, *cases, timeout=PATIENCE)
            assert result.stdout.split("\n")[:-1] == [f"STATUS {case} 0" for case in cases], result.stderr
    return top


@pytest.mark.parametrize(("ranks", "cases"), [(1, ["0d", *SPACE]), (2, SPACE), (3, SPACE)])
def test_the_same_bits_on_the_same_and_on_other_ranks(mpirun, runs, ranks, cases):
    for case in cases:
        shutil.copytree(runs / "half" / case, runs / f"on-{ranks}" / case)
    result = mpirun(ranks, PROGRAM, runs, f"on-{ranks}", *cases, timeout=PATIENCE)
    assert result.stdout.split("\n")[:-1] == [f"STATUS {case} 0" for case in cases], result.stderr
    for case in cases:
        assert_same(runs / "whole" / case, runs / f"on-{ranks}" / case, step=6)
        log = (runs / f"on-{ranks}" / case / "run.log").read_text()
        assert "restart from step 3" in log


def test_a_damaged_newest_checkpoint_costs_some_steps_and_no_bits(mpirun, runs):
    """A rank that has nothing of the damaged row goes back with the others."""
    directory = runs / "damaged" / "2d-walls"
    shutil.copytree(runs / "whole" / "2d-walls", directory)
    good = runs / "half" / "2d-walls" / "checkpoint-00000003.h5"
    shutil.copy(good, directory)
    bad = directory / "checkpoint-00000006.h5"
    with h5py.File(bad, "r+") as file:
        file["g"][0, 8, 17] *= 1.5
    result = mpirun(2, PROGRAM, runs, "damaged", "2d-walls", timeout=PATIENCE)
    assert result.stdout == "STATUS 2d-walls 0\n", result.stderr
    log = (directory / "run.log").read_text()
    assert f"{bad} is damaged: the checksum of cell (8, 0) does not fit (g)" in log
    assert f"going on from {directory / good.name}, the one before" in log
    assert_same(runs / "whole" / "2d-walls", directory, step=6)


def test_when_one_rank_cannot_write_the_run_ends_with_3_and_what_was_there_stays(mpirun, runs):
    directory = runs / "disk-full" / "2d-walls"
    shutil.copytree(runs / "half" / "2d-walls", directory)
    before = (directory / "checkpoint-00000003.h5").read_bytes()
    result = mpirun(2, PROGRAM, runs, "disk-full", "2d-walls", timeout=PATIENCE)
    assert result.stdout == "STATUS 2d-walls 3\n", result.stderr
    lines = [line for line in result.stderr.splitlines() if line.startswith("rvm: ")]
    assert len(lines) == 1
    assert re.search(r"checkpoint-00000006\.h5 cannot be written: .*\(rank 1\); the checkpoint of step 3", lines[0])
    assert [p.name for p in directory.glob("checkpoint*")] == ["checkpoint-00000003.h5"]
    assert (directory / "checkpoint-00000003.h5").read_bytes() == before


# -- stopping ---------------------------------------------------------------------------------------------

JOB = job_text(
    space={"cells": [8, 6]},
    collision={**GRANULAR, "restitution": 0.999},
    fluid={"enabled": True},
    time={"end": 1000.0},
    output={"times": [0.0, 0.01, 1000.0]},
)


def rows(directory):
    try:
        return (directory / "history.csv").read_text().splitlines()[1:]
    except FileNotFoundError:
        return []


def ranks_of(mpirun):
    return [int(pid) for pid in Path(f"/proc/{mpirun.pid}/task/{mpirun.pid}/children").read_text().split()]


def stop_run(ranks, job, directory, stop, *options):
    """Start a run, disturb it by `stop(mpirun's process)` after a few new steps; returns status and stderr."""
    done = len(rows(directory))
    line = start_line(ranks, "-m", "rvm_mpi", "run", job, "--output", directory, *options)
    with subprocess.Popen(
        line, env=mpi_environment(), stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            limit = time.monotonic() + PATIENCE
            while len(rows(directory)) < done + 3 and process.poll() is None and time.monotonic() < limit:
                time.sleep(0.02)
            if stop is not None and process.poll() is None:
                stop(process)
            _, stderr = process.communicate(timeout=PATIENCE)
        except BaseException:
            os.killpg(process.pid, signal.SIGTERM)
            raise
    return process.returncode, stderr


def test_whatever_stops_a_run_it_goes_on_with_the_same_bits(mpirun, tmp_path):
    """Stopped five times, each time for another reason and on another number of ranks; then once undisturbed."""
    job, directory = tmp_path / "job.toml", tmp_path / "run"
    job.write_text(JOB)
    ways = [
        ("SIGUSR1", 2, lambda process: process.send_signal(signal.SIGUSR1)),  # mpirun forwards it
        ("SIGTERM", 2, lambda process: os.kill(ranks_of(process)[1], signal.SIGTERM)),
        ("SIGINT", 1, lambda process: os.kill(ranks_of(process)[0], signal.SIGINT)),
        ("the file ", 2, lambda process: (directory / "stop").touch()),
        ("the wall-clock limit", 2, None),
    ]
    restart = []
    for reason, ranks, stop in ways:
        options = [*restart, *(["--walltime", "00:00:03"] if stop is None else [])]
        status, stderr = stop_run(ranks, job, directory, stop, *options)
        assert status == 75, stderr
        said = next(line for line in stderr.splitlines() if "stopped by" in line)
        step = int(rows(directory)[-1].split(",")[0])
        assert f"stopped by {reason}" in said
        assert f"after step {step} at t = " in said
        assert said.endswith(f" -m rvm_mpi run {directory}/job.toml --output {directory} --restart")
        assert f" -n {ranks} " in said.partition("go on with: ")[2]
        last = (directory / "run.log").read_text().splitlines()[-1]
        assert last.startswith(f"ended: stopped by {reason}")
        assert (directory / f"checkpoint-{step:08d}.h5").exists()
        assert len(list(directory.glob("checkpoint-*"))) <= 2
        restart = ["--restart"]
    assert not (directory / "stop").exists()
    steps = int(rows(directory)[-1].split(",")[0]) + 2
    most = f"time.max_steps={steps}"
    status, stderr = stop_run(2, directory / "job.toml", directory, None, "--restart", "--set", most)
    assert status == 0, stderr
    whole = tmp_path / "whole"
    result = mpirun(2, "-m", "rvm_mpi", "run", job, "--output", whole, "--set", most, "--quiet", timeout=PATIENCE)
    assert result.returncode == 0, result.stderr
    assert [line.split(",")[0] for line in rows(directory)] == [str(n) for n in range(steps + 1)]
    assert_same(whole, directory, steps)


def test_what_cannot_be_restarted_is_refused(mpirun, tmp_path):
    job, directory = tmp_path / "job.toml", tmp_path / "run"
    job.write_text(JOB)
    result = mpirun(2, "-m", "rvm_mpi", "run", job, "--output", directory, "--restart", timeout=PATIENCE)
    assert result.returncode == 2
    assert f"rvm: {directory}: nothing to restart" in result.stderr
    assert not directory.exists()
    first = ["-m", "rvm_mpi", "run", job, "--output", directory, "--set", "time.max_steps=1", "--quiet"]
    assert mpirun(2, *first, timeout=PATIENCE).returncode == 0
    before = {path.name: path.read_bytes() for path in directory.iterdir()}
    result = mpirun(2, *first, "--restart", "--set", "collision.knudsen=0.2", timeout=PATIENCE)
    assert result.returncode == 2
    assert "cannot restart as another job: collision.knudsen is 0.2, was 0.1" in result.stderr
    next(directory.glob("checkpoint-*")).write_bytes(b"nothing")
    result = mpirun(2, *first, "--restart", timeout=PATIENCE)
    assert result.returncode == 2
    assert "nothing to restart from" in result.stderr
    assert "checkpoint-00000001.h5 is damaged" in result.stderr
    before["checkpoint-00000001.h5"] = b"nothing"
    assert {path.name: path.read_bytes() for path in directory.iterdir()} == before
