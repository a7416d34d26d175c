"""Signals in every phase of a run: it stops with a checkpoint and status 75, or had not begun.

The stop file, the wall-clock limit and signals to single ranks between steps: tests/parallel/test_restart.py.
"""

import os
import shlex
import signal
import subprocess
import time

import pytest
from conftest import start_line
from faults.faulty import BOUND, ROOT, Started, assert_readable, assert_same, mpi_environment, run, wait_for

from rvm_mpi.output import rundir

pytestmark = pytest.mark.timeout(600)

SCRIPT = (str(ROOT / "jobs" / "mpirun.sh"),)
#: where a rank gets the signal
PHASES = {
    "start-up": "init:1:1",
    "opening the results": "open:1:1",
    "the first row": "history:0:1",
    "a step": "step:1:5",
    "a snapshot": "fields:0:2",
    "a checkpoint's beginning": "create:0:4",
    "within a checkpoint": "sums:1:7",
    "a checkpoint's renaming": "rename:0:9",
}
QUICK = ("start-up", "within a checkpoint")


def assert_goes_on(place, whole):
    options = ["--output", place / "run", "--restart", "--quiet"]
    assert run(3, [], place / "job.toml", *options, log=place / "log") == (0, []), (place / "log").read_text()
    assert_same(place / "run", whole)


@pytest.mark.parametrize(
    "phase", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in PHASES]
)
def test_a_signal_to_a_rank(place, whole, phase, tally):
    number = {"start-up": "SIGTERM", "a step": "SIGINT"}.get(phase, "SIGUSR1")
    status, lines = run(
        2, [f"{number}:{PHASES[phase]}"], place / "job.toml", "--output", place / "run", log=place / "log"
    )
    assert status == 75, (place / "log").read_text()
    assert len(lines) == 1
    assert f"stopped by {number} after step" in lines[0]
    assert rundir.checkpoints(place / "run")
    assert_readable(place / "run", whole)
    assert_goes_on(place, whole)
    tally["signals in a phase"] += 1


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.long), "Ctrl-C"])
def test_what_mpirun_would_answer_by_killing_reaches_the_ranks_through_the_script(place, whole, number, tally):
    arguments = ["run", place / "job.toml", "--output", place / "run"]
    with Started(2, ["0.1:step:all:each"], *arguments, mpirun=SCRIPT, log=place / "log") as started:
        wait_for(lambda: rundir.checkpoints(place / "run"), started)
        if number == "Ctrl-C":  # a terminal sends it to the group
            os.killpg(started.process.pid, signal.SIGINT)
        else:
            started.process.send_signal(number)
        assert started.wait() == 75, (place / "log").read_text()
        assert "stopped by SIGUSR1 after step" in started.lines()[0]
    assert_goes_on(place, whole)
    tally["signals in a phase"] += 1


def test_the_script_is_mpirun_otherwise(place):
    line = start_line(2, "-c", "import os; print('up'); os._exit(3)", mpirun=SCRIPT)
    done = subprocess.run(line, env=mpi_environment(), capture_output=True, text=True, timeout=60)
    assert done.returncode == 3
    assert "up" in done.stdout


def test_the_line_that_says_how_to_go_on_is_a_command_that_does(place):
    line = list(map(str, start_line(2, "-m", "rvm_mpi", mpirun=SCRIPT)))
    directory = place / "a run"
    command = shlex.join([*line, "run", "job.toml", "--output", directory.name, "--set", "time.max_steps=1000000"])
    history = directory / "history.csv"
    for _turn in range(2):
        before = history.stat().st_size if history.exists() else 0
        with subprocess.Popen(
            ["bash", "-c", f"exec {command}"], cwd=place, env=mpi_environment() | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
        ) as process:  # fmt: skip
            limit = time.monotonic() + BOUND
            while process.poll() is None and time.monotonic() < limit:
                if history.exists() and history.stat().st_size > before and rundir.checkpoints(directory):
                    break
                time.sleep(0.05)
            process.send_signal(signal.SIGTERM)
            _, said = process.communicate(timeout=BOUND)
        assert process.returncode == 75, said
        command = next(text for text in said.splitlines() if "stopped by" in text).partition("go on with: ")[2]
        assert command == shlex.join([*line, "run", "a run/job.toml", "--output", "a run", "--restart"])


def test_ctrl_c_before_the_run_begins_is_no_traceback(place):
    options = ["--output", place / "run"]
    status, lines = run(1, ["SIGINT:read:0:1"], place / "job.toml", *options, log=place / "log")
    assert status == 130
    assert lines == ["rvm: interrupted"]
    assert not (place / "run").exists()
