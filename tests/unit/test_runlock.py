"""One run at a time in a directory: who has it, when it is free again, and that two never get it."""

import json
import os
import platform
import signal
import subprocess
import sys
import time
from dataclasses import asdict, replace

import pytest
from mpi4py import MPI

from rvm_mpi.job.job import JobError
from rvm_mpi.output import lock as runlock
from rvm_mpi.output import rundir
from rvm_mpi.output.lock import Lock, Owner
from rvm_mpi.run.claim import Claim, DirectoryLost


def left(directory, owner, age=0.0):
    """A lock file of this owner, last touched so many seconds ago."""
    path = directory / "lock"
    path.write_text(json.dumps(asdict(owner)))
    now = path.stat().st_mtime
    os.utime(path, (now - age, now - age))
    return path


def names(directory):
    return sorted(path.name for path in directory.iterdir())


def test_taken_once_and_free_again_at_the_end(tmp_path):
    lock = Lock(tmp_path)
    assert lock.held()
    for attempt in (Lock, runlock.refuse_live, rundir.check):
        with pytest.raises(JobError, match=rf"a run on {platform.node()} \(process {os.getpid()}.* is writing into it"):
            attempt(tmp_path)
    assert names(tmp_path) == ["lock"]
    lock.release()
    assert names(tmp_path) == []
    Lock(tmp_path).release()


def test_what_a_killed_process_left_is_taken_over_at_once(tmp_path):
    code = "import sys, pathlib, time, rvm_mpi.output.lock as r; r.Lock(pathlib.Path(sys.argv[1])); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)]) as process:
        limit = time.monotonic() + 30
        while not (tmp_path / "lock").exists():
            assert time.monotonic() < limit
            time.sleep(0.01)
        time.sleep(0.1)
        with pytest.raises(JobError, match=f"process {process.pid}"):
            Lock(tmp_path)
        process.send_signal(signal.SIGKILL)
        limit = time.monotonic() + 10
        while runlock.read(tmp_path / "lock").runs_here():  # dead, and not yet waited for
            assert time.monotonic() < limit
    lock = Lock(tmp_path)
    assert lock.held()
    lock.release()
    assert names(tmp_path) == []


HERE = Owner.this_process()
GONE = {
    "another process has its number": (replace(HERE, started="1"), 0.0),
    "no such process": (replace(HERE, pid=2**22 + 1), 0.0),
    "nonsense for a process": (replace(HERE, pid=-1), 0.0),
    "the machine was started anew": (replace(HERE, boot="before"), 61.0),
    "another machine, silent": (replace(HERE, host="elsewhere", boot="other"), 301.0),
    "another container, silent": (replace(HERE, namespace="pid:[1]"), 301.0),
}
THERE = {
    "this process": (HERE, 1e6),
    "another machine": (replace(HERE, host="elsewhere", boot="other"), 200.0),
    "another container": (replace(HERE, namespace="pid:[1]"), 200.0),
    "a machine with this one's name": (replace(HERE, boot="other"), 30.0),
    "the first process of the system": (replace(HERE, pid=1, started=runlock._start_of(1)), 1e6),
    "another job of SLURM": (replace(HERE, host="elsewhere", boot="other", slurm_job="6"), 0.0),
    "another step of the SLURM job": (
        replace(HERE, host="elsewhere", boot="other", slurm_job="7", slurm_restart=1), 0.0,
    ),
}


@pytest.mark.parametrize("case", GONE)
def test_gone(tmp_path, case):
    left(tmp_path, replace(GONE[case][0], id="x"), GONE[case][1])
    lock = Lock(tmp_path)
    assert lock.held()
    lock.release()
    assert names(tmp_path) == []


@pytest.mark.parametrize("case", THERE)
def test_there(tmp_path, case, monkeypatch):
    monkeypatch.setenv("SLURM_JOB_ID", "7")
    monkeypatch.setenv("SLURM_RESTART_COUNT", "1")
    path = left(tmp_path, replace(THERE[case][0], id="x"), THERE[case][1])
    before = path.read_bytes()
    with pytest.raises(JobError, match="is writing into it") as caught:
        Lock(tmp_path)
    known = case in ("this process", "the first process of the system")
    assert (f"remove {path}" in str(caught.value)) is not known
    assert "\n" not in str(caught.value)
    assert names(tmp_path) == ["lock"]
    assert path.read_bytes() == before


def test_a_slurm_job_that_was_put_back_into_the_queue_takes_what_it_left_on_another_machine(tmp_path, monkeypatch):
    monkeypatch.setenv("SLURM_JOB_ID", "7")
    monkeypatch.setenv("SLURM_RESTART_COUNT", "2")
    left(tmp_path, replace(HERE, id="x", host="elsewhere", boot="other", slurm_job="7", slurm_restart=1))
    Lock(tmp_path).release()


@pytest.mark.parametrize("text", ["", "{}", "[1]", "nonsense", '{"id": "x"}'])
def test_a_lock_that_says_nothing_is_told_by_its_age(tmp_path, text):
    path = tmp_path / "lock"
    path.write_text(text)
    runlock.refuse_live(tmp_path)  # not known to be there
    with pytest.raises(JobError, match=f"a run that has not said who it is.* remove {path}"):
        Lock(tmp_path)
    os.utime(path, (1.0, 1.0))
    Lock(tmp_path).release()


def test_a_run_shows_signs_of_life(tmp_path, monkeypatch):
    monkeypatch.setattr(runlock, "BEAT", 0.05)
    lock = Lock(tmp_path)
    os.utime(lock.path, (1.0, 1.0))
    limit = time.monotonic() + 10
    while runlock.seconds_of_silence(lock.path) > 5.0:
        assert time.monotonic() < limit
    # none in the lock of a run that has taken the directory over
    left(tmp_path, replace(HERE, id="other")).replace(tmp_path / "lock.new")
    (tmp_path / "lock.new").replace(lock.path)
    lock.release()
    assert names(tmp_path) == ["lock"]


@pytest.mark.parametrize("links", [True, False])
def test_of_many_at_one_instant_one_gets_what_a_killed_run_left(tmp_path, links):
    code = (
        "import os, sys, pathlib, time\n"
        "from rvm_mpi.output import lock as runlock\n"
        "from rvm_mpi.job.text import JobError\n"
        "def refuse(*_): raise PermissionError(1, 'no links here')\n"
        f"if not {links}: os.link = refuse\n"
        "while time.time() < float(sys.argv[2]): pass\n"
        "try:\n"
        "    runlock.Lock(pathlib.Path(sys.argv[1])); print('mine', flush=True); time.sleep(3)\n"
        "except JobError as error:\n"
        "    print('refused', error)\n"
    )
    for round_ in range(3):
        left(tmp_path, replace(HERE, id=f"x{round_}", pid=2**22 + 1))
        at = str(time.time() + 1.5)
        line = [sys.executable, "-c", code, str(tmp_path), at]
        started = [subprocess.Popen(line, stdout=subprocess.PIPE, text=True) for _ in range(6)]
        said = [process.communicate(timeout=60)[0] for process in started]
        assert sum(text == "mine\n" for text in said) == 1, said
        assert sum(text.startswith("refused ") for text in said) == 5, said
        assert names(tmp_path) == ["lock"]


def test_a_claim_makes_the_directory_and_leaves_no_trace_of_a_failure(tmp_path):
    directory = tmp_path / "a" / "b"
    with pytest.raises(ZeroDivisionError), Claim(directory, MPI.COMM_SELF) as claim:
        claim.check()
        assert names(directory) == ["lock"]
        raise ZeroDivisionError
    assert names(tmp_path) == []
    with Claim(directory, MPI.COMM_SELF):
        (directory / "job.toml").write_text("")
    assert names(directory) == ["job.toml"]


def test_a_directory_that_was_moved_is_noticed(tmp_path):
    directory = tmp_path / "run"
    with Claim(directory, MPI.COMM_SELF) as claim:
        directory.rename(tmp_path / "aside")
        with pytest.raises(DirectoryLost, match="is no longer this run's: it was moved, or its lock removed"):
            claim.check()
        directory.mkdir()
        with Claim(directory, MPI.COMM_SELF), pytest.raises(DirectoryLost, match=r"a run on .* has it"):
            claim.check()
    assert names(directory) == []
