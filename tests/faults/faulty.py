"""Runs with faults: started under mpirun, watched by their processes, compared with an undisturbed run."""

import contextlib
import os
import signal
import subprocess
import time
from pathlib import Path

import h5py
import numpy as np
from conftest import MPIRUN, ROOT, mpi_environment, start_line
from small_runs import job_text

from rvm_mpi.results import open_run, read_history

PROGRAM = Path(__file__).with_name("program.py")
STEPS = 14
#: seconds in which a run as small as these has ended, whatever happened to it, also on a busy machine
BOUND = 90.0
#: the same for the first run of all, which may have to compile the kernels
COMPILING = 600.0

TIMES = (0.0, 0.01, 0.02, 0.03, 0.04)

JOB = job_text(
    space={"cells": [9, 6], "boundary": {"y": "diffuse"}},
    fluid={"enabled": True},
    time={"end": 1000.0, "max_steps": STEPS},
    output={"times": [*TIMES, 1000.0], "checkpoint_every": "1e-9 s"},  # after each step
)


def _heed_ctrl_c():
    """What is started from tests in the background of a shell would ignore Ctrl-C, and no script could change that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Started:
    """`mpirun -n RANKS` of program.py with these faults, running.

    Standard error goes to a file: a test that looks elsewhere must not leave a run waiting on a full pipe.
    """

    def __init__(self, ranks, faults, *arguments, mpirun=(MPIRUN,), log, environment=()):
        line = start_line(ranks, PROGRAM, *faults, "--", *map(str, arguments), mpirun=mpirun)
        self.log = log
        with log.open("w") as stream:
            self.process = subprocess.Popen(
                line, cwd=ROOT, env=mpi_environment() | dict(environment), stdin=subprocess.DEVNULL,
                stdout=stream, stderr=stream, start_new_session=True, preexec_fn=_heed_ctrl_c,
            )  # fmt: skip
        self.ranks = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        """Nothing of it stays, whatever the test says."""
        for pid in [self.process.pid, *self.find_ranks()]:
            kill(pid, signal.SIGKILL)
        self.process.wait()

    def find_ranks(self):
        """Process ids of the ranks, as far as they have been started."""
        found = descendants(self.process.pid)
        self.ranks = [*self.ranks, *(pid for pid in found if pid not in self.ranks)]
        return self.ranks

    def wait(self, bound=BOUND):
        """Exit status, once all processes are gone; an AssertionError if they are not in time."""
        limit = time.monotonic() + bound
        while self.process.poll() is None and time.monotonic() < limit:
            self.find_ranks()
            time.sleep(0.02)
        said = self.log.read_text()
        assert self.process.poll() is not None, f"no end after {bound} s\n{said}"
        while any(map(is_running, self.ranks)) and time.monotonic() < limit:
            time.sleep(0.02)
        left = [pid for pid in self.ranks if is_running(pid)]
        assert not left, f"processes left: {left}\n{said}"
        return self.process.returncode

    def lines(self):
        """What rvm itself said of an end that was not the end of the run."""
        text = self.log.read_text(errors="replace")
        assert "Traceback" not in text, text
        return [line for line in text.splitlines() if line.startswith("rvm: ")]


def run(ranks, faults, *arguments, bound=BOUND, **more):
    """Run to the end: exit status and the lines that rvm said."""
    with Started(ranks, faults, "run", *arguments, **more) as started:
        status = started.wait(bound)
        return status, started.lines()


def descendants(pid):
    """Python processes below a process."""
    found = []
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        for child in map(int, children):
            if Path(f"/proc/{child}/comm").read_text().startswith("python"):
                found.append(child)
            found += descendants(child)
    except (FileNotFoundError, ProcessLookupError):
        pass
    return found


def kill(pid, number):
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_for(condition, started):
    """Until the condition holds or the run has ended."""
    limit = time.monotonic() + BOUND
    while not condition() and started.process.poll() is None:
        assert time.monotonic() < limit, started.log.read_text()
        started.find_ranks()
        time.sleep(0.005)


def datasets(path):
    """Shape and bytes of all datasets of an HDF5 file by name."""
    found = {}

    def take(name, item):
        if isinstance(item, h5py.Dataset):
            found[name] = (item.shape, item[()].tobytes())

    with h5py.File(path, "r") as file:
        file.visititems(take)
    return found


def snapshots(directory):
    """Bytes of all snapshots that a job with these output times and this end asks for, by name and time."""
    fields, last = open_run(directory), read_history(directory)["time"][-1]
    times = [time for time in fields.time.values if time in TIMES or time == last]
    return {(name, time): fields[name].sel(time=time).values.tobytes() for name in fields.data_vars for time in times}


def assert_same(directory, whole):
    """The bits of fields, history and last checkpoint."""
    assert (directory / "history.csv").read_bytes() == (whole / "history.csv").read_bytes()
    assert snapshots(directory) == snapshots(whole)
    name = f"checkpoint-{STEPS:08d}.h5"
    assert datasets(directory / name) == datasets(whole / name), name


def assert_readable(directory, whole):
    """What is there of an ended run: snapshots that exist have their bits, rows of the history theirs."""
    if (directory / "fields.h5").exists():
        there, wanted = open_run(directory), open_run(whole)
        for time_ in there.time.values[:5]:  # the sixth holds the end of a run cut short
            if time_ in wanted.time.values:
                one, other = there.sel(time=time_), wanted.sel(time=time_)
                assert all(np.array_equal(one[name], other[name]) for name in wanted)
    if (directory / "history.csv").exists():
        text = (directory / "history.csv").read_bytes()
        assert (whole / "history.csv").read_bytes().startswith(text)
