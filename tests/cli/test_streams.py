"""Who listens, what he can show, and who has started us: none of it decides whether a command works."""

import os
import subprocess
import sys
import time

import pytest
from conftest import ROOT
from small_runs import LAUNCHED, environment, job_text, shell

from rvm_mpi.job.text import JobError
from rvm_mpi.output import rundir
from rvm_mpi.run import launch
from rvm_mpi.run.launch import Launch, launched

pytestmark = pytest.mark.timeout(300)

JOB = job_text(
    title="Übergang ρ→T",
    space={"cells": [12], "boundary": {"x": "diffuse"}},
    velocity={"points": [12, 8]},
    collision={"operator": "es-bgk", "knudsen": 0.1},
    initial={"state": "uniform"},
    time={"end": 0.2},
    output={"times": [0.0, 0.1, 0.2]},
)
LONG = ("--set", "time.end=1e3", "--set", "output.times=[1e3]")


@pytest.fixture
def place(tmp_path):
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    return tmp_path


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A folder with a finished run in it."""
    top = tmp_path_factory.mktemp("run")
    (top / "job.toml").write_text(JOB, encoding="utf-8")
    assert shell("rvm run job.toml --output run --quiet", top)[0] == 0
    return top


@pytest.mark.parametrize("number", ["HUP", "USR2", "XCPU"])
def test_a_signal_ends_a_run_with_a_checkpoint(place, number):
    script = (
        f"{sys.executable} -m rvm_mpi run job.toml --output run {' '.join(LONG)} 2> log & "
        f"until [ -s run/history.csv ]; do sleep 0.1; done; sleep 0.3; kill -{number} $!; wait $!"
    )
    assert shell(script, place)[0] == 75
    assert rundir.checkpoints(place / "run")
    last = (place / "run" / "run.log").read_text().splitlines()[-1]
    assert last.startswith(f"ended: stopped by SIG{number} after step ")
    assert last.endswith(f"go on with: {sys.executable} -m rvm_mpi run run/job.toml --output run --restart")
    assert f"stopped by SIG{number}" in shell("rvm info run", place)[1]


@pytest.mark.parametrize("where", ["2>&1 | true", "2> /dev/full", "2>&-", "<&- >&- 2>&-"])
def test_a_run_needs_no_reader(place, where):
    status, said, _ = shell(f"rvm run job.toml --output run {where}", place)
    assert (status, said) == (0, "")
    log = (place / "run" / "run.log").read_text(encoding="utf-8")
    assert "step 3, " in log
    assert log.splitlines()[-1].startswith("ended: done: step ")


@pytest.mark.parametrize("command", ["check job.toml", "info run", "compare run run", "--help", "--version"])
def test_a_reader_that_has_seen_enough_is_no_failure(run, command):
    assert shell(f"rvm {command} | true", run) == (0, "", "")
    assert shell(f"PYTHONUNBUFFERED=1 rvm {command} | true", run) == (0, "", "")


def test_an_answer_that_is_lost_on_a_full_disk_is_one(run):
    status, _, said = shell("rvm check job.toml > /dev/full", run)
    assert status == 3
    assert said == "rvm: rank 0: OSError: standard output cannot be written: No space left on device\n"


ASCII = [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}]


@pytest.mark.parametrize("variables", [*ASCII, {"LC_ALL": "C"}, {"LANG": "C"}], ids=str)
def test_a_terminal_shows_what_it_can(run, variables):
    for command in ("check job.toml", "info run"):
        status, said, complaint = shell(f"rvm {command}", run, **variables)
        assert (status, complaint) == (0, "")
        if variables in ASCII:
            assert "?bergang ??T" in said


@pytest.mark.parametrize("variables", [{}, *ASCII], ids=str)
def test_names_that_are_no_text(place, variables):
    script = """name=$(printf 'n\\377'); cp job.toml "$name.toml"
    rvm run "$name.toml" --output "$name" --set time.max_steps=3 && rvm info "$name" && rvm check "$name.toml"
    rvm run job.toml --output other --set "title=\\"$name\\"" """
    status, said, complaint = shell(script, place, **variables)
    assert status == 2, complaint
    assert "done: step 3" in said
    assert complaint.splitlines()[-1].endswith("not UTF-8 text")
    assert "Traceback" not in complaint


def test_the_command_to_go_on_holds_names_that_are_no_text(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["bin/rvm", "run"])
    assert launch.again(["a b", os.fsdecode(b"n'\xff")], 1) == "bin/rvm 'a b' $'n\\047\\377'"
    monkeypatch.setattr(sys, "argv", ["my_script.py"])
    assert launch.again(["run"], 3) == f"mpirun -n 3 {sys.executable} -m rvm_mpi run"


# -- launchers ----------------------------------------------------------------------------------------------

STEP = {"SLURM_STEP_ID": "0", "SLURM_STEPID": "0", "SLURM_STEP_NUM_TASKS": "4", "SLURM_JOB_ID": "7",
        "SLURM_JOBID": "7", "SLURM_NTASKS": "4", "SLURM_NODELIST": "localhost", "SLURM_NNODES": "1"}  # fmt: skip
BATCH = {"SLURM_JOB_ID": "7", "SLURM_JOBID": "7", "SLURM_PROCID": "0", "SLURM_NTASKS": "8"}


@pytest.mark.parametrize(
    ("variables", "found"),
    [
        ({}, Launch(0, 1, "")),
        ({"OMPI_COMM_WORLD_RANK": "1", "OMPI_COMM_WORLD_SIZE": "3"}, Launch(1, 3, "OMPI_COMM_WORLD_SIZE")),
        ({"PMI_RANK": "1", "PMI_SIZE": "2"}, Launch(1, 2, "PMI_SIZE")),
        ({**STEP, "SLURM_PROCID": "3"}, Launch(3, 4, "SLURM_STEP_ID")),
        (BATCH, Launch(0, 1, "")),
        ({**BATCH, "SLURM_STEP_ID": "4294967291"}, Launch(0, 1, "")),  # the batch step's own number
        ({"SLURM_PROCID": "1"}, Launch(0, 1, "")),
        # srun starts an mpirun's daemons on other nodes
        ({**STEP, "SLURM_PROCID": "1", "PMI_RANK": "5", "PMI_SIZE": "8"}, Launch(5, 8, "PMI_SIZE")),
    ],
    ids=str,
)
def test_what_the_launcher_says(monkeypatch, variables, found):
    for name in [name for name in os.environ if name.startswith(LAUNCHED)]:
        monkeypatch.delenv(name)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert launched() == found


@pytest.mark.parametrize("variables", [{"SLURM_PROCID": "1"}, {**STEP, "SLURM_PROCID": "2"}, {"PMIX_RANK": "1"},
                                       {"PMI_RANK": "1", "PMI_SIZE": "2"}], ids=str)  # fmt: skip
def test_commands_of_one_process_speak_in_every_process(run, variables):
    for command in ("check job.toml", "info run", "compare run run"):
        status, said, _ = shell(f"rvm {command}", run, **variables)
        assert status == 0
        assert said


@pytest.mark.parametrize(
    "variables", [{"PMI_SIZE": "2"}, {"MV2_COMM_WORLD_SIZE": "2"}, STEP], ids=["PMI", "MV2", "srun"]
)
def test_processes_that_mpi_does_not_see_are_refused_in_one_line(place, variables):
    name = next(iter(variables))
    for rank, lines in ((0, 1), (1, 0)):
        more = {**variables, name.replace("SIZE", "RANK"): str(rank), "SLURM_PROCID": str(rank)} | (
            STEP if variables is STEP else {}
        )
        status, said, complaint = shell("rvm run job.toml --output run", place, **more)
        assert (status, said, complaint.count("\n")) == (2, "", lines), complaint
        if rank == 0:
            assert "processes were started, but MPI (Open MPI" in complaint
            assert f"env -u {name}" in complaint
    assert not (place / "run").exists()
    # what the line says is true
    assert shell(f"env -u {name} {sys.executable} -m rvm_mpi run job.toml --output run --quiet", place, **more)[0] == 0


@pytest.mark.parametrize("variables", [BATCH, {**STEP, "SLURM_STEP_NUM_TASKS": "1"}], ids=["batch", "srun -n 1"])
def test_a_run_alone_within_slurm(place, variables):
    assert shell("rvm run job.toml --output run --quiet", place, **variables) == (0, "", "")


def test_a_farm_of_different_runs_is_no_run(mpirun, place):
    farm = f'"{sys.executable}" -m rvm_mpi run job.toml --output run-$OMPI_COMM_WORLD_RANK'
    code = f"import os; os.execvp('sh', ['sh', '-c', {farm!r}])"
    done = mpirun(2, "-c", code, cwd=place, env={"PYTHONPATH": str(ROOT)}, timeout=60)
    assert done.returncode == 2
    spoken = [line for line in done.stderr.splitlines() if line.startswith("rvm: ")]
    assert len(spoken) == 1
    assert "rank 1 was given another job, directory or option" in spoken[0]
    assert not list(place.glob("run-*"))


def test_kernels_that_may_not_be_compiled(place):
    status, said, complaint = shell("rvm run job.toml --output run", place, NUMBA_DISABLE_JIT="1")
    assert (status, said, complaint.count("\n")) == (2, "", 1)
    assert "NUMBA_DISABLE_JIT" in complaint


def test_a_run_that_was_killed(place):
    line = [sys.executable, "-m", "rvm_mpi", "run", "job.toml", "--output", "run", "--quiet", *LONG]
    with subprocess.Popen(line, cwd=place, env=environment()) as process:
        limit = time.monotonic() + 120
        while not (place / "run" / "history.csv").exists() and time.monotonic() < limit:
            time.sleep(0.05)
        process.kill()
    assert "state         killed: it has said no end, and its process is gone" in shell("rvm info run", place)[1]
    (place / "run" / "lock").unlink()
    assert "or just killed" in shell("rvm info run", place)[1]
    for file in (place / "run").iterdir():
        os.utime(file, (1e9, 1e9))
    assert "killed, or stands still" in shell("rvm info run", place)[1]


@pytest.mark.parametrize(
    ("keys", "cure"),
    [
        ({"operator": "granular-es-bgk", "restitution": 0.9, "knudsen": 1e-20}, "restitution nearer to 1"),
        ({"operator": "boltzmann", "restitution": 1.0, "knudsen": 1e-20}, "penalise"),
        ({"operator": "boltzmann", "restitution": 1.0, "knudsen": 5e-324}, "overflows"),
    ],
    ids=str,
)
def test_a_step_that_leads_nowhere_is_refused_before(place, keys, cure):
    from rvm_mpi.advice.first_step import check_first_step
    from rvm_mpi.job.job import Job

    job = Job.from_dict({"space": {"cells": [4]}, "velocity": {"points": [8, 8]}, "collision": keys,
                         "initial": {"state": "uniform"}, "time": {"end": 1.0}})  # fmt: skip
    with pytest.raises(JobError, match=cure):
        check_first_step(job)
