"""A wrong request ends at once: one line, exit 2, no traceback, nothing written, alone and under mpirun."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_runs import contents, environment

ROOT = Path(__file__).resolve().parents[2]
IN_TIME = 2.0
"""Seconds after start-up in which a wrong request must have ended."""

GOOD = """
[space]
cells = [12, 12]
[velocity]
points = [8, 8, 8]
[collision]
operator = "granular-es-bgk"
knudsen = 0.1
restitution = 0.9
[initial]
state = "uniform"
[time]
end = 1.0
"""

# what is wrong: job text, further arguments, what the line must name
BAD = {
    "broken TOML": (GOOD + "\n[output\n", (), ("job.toml", "not valid TOML", "line")),
    "unknown key": (GOOD.replace("knudsen", "knudsn"), (), ("collision.knudsn", 'did you mean "knudsen"?')),
    "wrong type": (GOOD.replace("0.1", '"a tenth"'), (), ("collision.knudsen", "wrong type", "a tenth")),
    "negative knudsen": (GOOD, ("--set", "collision.knudsen=-1"), ("collision.knudsen", "-1", "> 0")),
    "restitution above 1": (GOOD, ("--set", "collision.restitution=1.5"), ("restitution", "1.5", "0 to 1")),
    "a state that does not fit": (
        GOOD.replace("[12, 12]", "[]").replace("uniform", "wave"),
        (),
        ("wave", "space"),
    ),
    "box too small": (
        GOOD,
        ("--set", 'scaling.kind="none"', "--set", "velocity.half_width=2"),
        ("half_width", "3.0"),
    ),
    "too coarse a box": (GOOD, ("--set", "initial.velocity=[9,0,0]"), ("velocity.points", "too few")),
    "a bare word": (GOOD, ("--set", "scaling.kind=none"), ("scaling.kind", "quotes")),
    "an unknown option": (GOOD, ("--outptu", "x"), ("--outptu",)),
    "a walltime": (GOOD, ("--walltime", "soon"), ("soon", "HH:MM:SS")),
    "nothing to restart": (GOOD, ("--restart",), ("out", "nothing to restart")),
}


def rvm(*arguments, cwd, **more):
    """Run the command alone; also the seconds it took."""
    start = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "rvm_mpi", *map(str, arguments)],
        cwd=cwd, env=environment(**more), capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    return done, time.monotonic() - start


def assert_refused(done, named):
    assert done.returncode == 2, done
    assert done.stdout == ""
    assert done.stderr.startswith("rvm: ")
    assert done.stderr.count("\n") == 1
    for words in named:
        assert words in done.stderr


@pytest.fixture
def place(tmp_path):
    """A directory with a good job in it."""
    (tmp_path / "job.toml").write_text(GOOD)
    return tmp_path


@pytest.mark.parametrize("case", BAD.values(), ids=BAD)
def test_refused_alone(place, case):
    text, arguments, named = case
    (place / "job.toml").write_text(text)
    before = contents(place)
    done, seconds = rvm("run", "job.toml", "--output", "out", *arguments, cwd=place)
    assert_refused(done, named)
    assert seconds < IN_TIME
    assert contents(place) == before
    assert not (place / "out").exists()


@pytest.mark.parametrize("name", ["missing.toml", "jbo.toml", "."])
def test_no_job_file(place, name):
    done, seconds = rvm("run", name, cwd=place)
    assert_refused(done, ["directory" if name == "." else f"{name}: no such file"])
    assert ('did you mean "job.toml"?' in done.stderr) == (name == "jbo.toml")
    assert seconds < IN_TIME
    assert contents(place).keys() == {"job.toml"}


def test_a_binary_file_is_no_job(place):
    (place / "fields.h5").write_bytes(b"\x89HDF\r\n\x1a\n\xff\xfe\x00")
    done, _ = rvm("run", "fields.h5", cwd=place)
    assert_refused(done, ["fields.h5", "not UTF-8"])


@pytest.mark.parametrize("mark", ["job.toml", "fields.h5", "history.csv", "run.log", "checkpoint-1.h5"])
def test_a_directory_that_holds_a_run(place, mark):
    out = place / "out"
    out.mkdir()
    (out / mark).write_text("an earlier run")
    before = contents(place)
    done, seconds = rvm("run", "job.toml", "--output", "out", cwd=place)
    assert_refused(done, ["out", "holds a run", "--restart", "--overwrite"])
    assert seconds < IN_TIME
    assert contents(place) == before


def test_the_default_directory_is_named_after_the_job(place):
    (place / "runs" / "job").mkdir(parents=True)
    (place / "runs" / "job" / "run.log").write_text("x")
    done, _ = rvm("run", "job.toml", cwd=place)
    assert_refused(done, ["runs/job: holds a run"])


def test_output_that_cannot_be_a_directory(place):
    done, _ = rvm("run", "job.toml", "--output", "job.toml", cwd=place)
    assert_refused(done, ["job.toml: is not a directory"])
    done, _ = rvm("run", "job.toml", "--output", "job.toml/out", cwd=place)
    assert_refused(done, ["is not a directory"])


def test_restart_and_overwrite_together(place):
    done, _ = rvm("run", "job.toml", "--restart", "--overwrite", cwd=place)
    assert_refused(done, ["exclude"])


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((), "run|check|info|compare|compile|bench"),
        (("rnu",), "rnu"),
        (("run",), "JOB.toml"),
        (("check",), "--states"),
        (("check", "job.toml", "--ranks", "0"), "--ranks"),
        (("check", "job.toml", "--ranks", "1000"), "largest"),
        (("info", "nowhere"), "no such directory"),
        (("info", "empty"), "holds no run"),
        (("bench", "--cells", "8"), "--cells"),
        (("bench", "--cells", "8", "x"), "'x'"),
    ],
)
def test_wrong_commands(place, arguments, named):
    (place / "empty").mkdir()
    done, _ = rvm(*arguments, cwd=place)
    assert_refused(done, [named])


def test_a_name_with_a_line_break_stays_on_one_line(place):
    done, _ = rvm("run", "two\nlines.toml", cwd=place)
    assert_refused(done, ["two\\nlines.toml"])


def test_a_good_job_is_valid(place):
    done, _ = rvm("check", "job.toml", "--ranks", "4", cwd=place)
    assert done.returncode == 0, done
    assert done.stderr == ""
    for words in (
        "job.toml: valid", "ranks of at most", "memory per rank", "first time step", "limited by",
        "steps", "run time", "mean free path", "collision time", "Knudsen number", "cells per mean path",
        "smallest T_g",
    ):  # fmt: skip
        assert words in done.stdout
    assert contents(place).keys() == {"job.toml"}


def test_states_are_listed(place):
    done, _ = rvm("check", "--states", cwd=place)
    assert done.returncode == 0
    assert "random-density" in done.stdout
    assert "correlation_length" in done.stdout


def test_version_and_help(place):
    from rvm_mpi import __version__

    done, _ = rvm("--version", cwd=place)
    assert done.stdout == f"rvm {__version__}\n"
    done, _ = rvm("run", "--help", cwd=place)
    assert done.returncode == 0
    assert "--restart" in done.stdout


def test_the_package_imports_no_mpi():
    code = (
        "import sys, rvm_mpi, rvm_mpi.commands.main, rvm_mpi.job.job\n"
        "print([m for m in ('mpi4py', 'petsc4py', 'numba', 'h5py') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(), capture_output=True, text=True, timeout=60
    )
    assert done.stdout.strip() == "[]", done


# --- under a launcher


def spoken(done):
    """The lines of standard error that are ours, not mpirun's."""
    return [line for line in done.stderr.splitlines() if line.startswith("rvm: ")]


# start-up: what mpirun and the imports need, and mpirun to end the other ranks when rank 0 has left
START_UP = """
import os, time
import rvm_mpi.commands.main, rvm_mpi.job.job, rvm_mpi.advice.start
if os.environ["OMPI_COMM_WORLD_RANK"] != "0":
    time.sleep(20)
raise SystemExit(2)
"""


STARTED: dict[int, float] = {}


def start_up(mpirun, ranks, anew=False):
    """Seconds of it, measured once, and again where a busy machine may have slowed down since."""
    if anew or ranks not in STARTED:
        start = time.monotonic()
        mpirun(ranks, "-c", START_UP, env={"PYTHONPATH": str(ROOT)}, timeout=30)
        STARTED[ranks] = time.monotonic() - start
    return STARTED[ranks]


@pytest.mark.parametrize(
    ("what", "ranks"), [("unknown key", 4), ("broken TOML", 4), ("box too small", 2), ("an unknown option", 2)]
)
def test_refused_on_all_ranks(mpirun, place, ranks, what):
    text, arguments, named = BAD[what]
    (place / "job.toml").write_text(text)
    before = contents(place)
    start_up(mpirun, ranks)
    start = time.monotonic()
    done = mpirun(
        ranks, "-m", "rvm_mpi", "run", "job.toml", "--output", "out", *arguments,
        cwd=place, env={"PYTHONPATH": str(ROOT)}, timeout=30,
    )  # fmt: skip
    seconds = time.monotonic() - start
    assert any(seconds < start_up(mpirun, ranks, anew) + IN_TIME for anew in (False, True))
    assert done.returncode == 2, done
    assert len(spoken(done)) == 1, done.stderr
    for words in named:
        assert words in spoken(done)[0]
    assert "Traceback" not in done.stderr
    assert contents(place) == before


def test_too_many_ranks_are_refused_before_anything_starts(mpirun, place):
    done = mpirun(
        4, "-m", "rvm_mpi", "run", "job.toml", "--set", "space.cells=[4, 4]",
        cwd=place, env={"PYTHONPATH": str(ROOT)}, timeout=30,
    )  # fmt: skip
    assert done.returncode == 2, done
    assert len(spoken(done)) == 1
    assert "4 ranks cannot share 4 x 4" in spoken(done)[0]
    assert contents(place).keys() == {"job.toml"}


def test_one_rank_alone_sees_the_error(mpirun, place):
    """Rank 1 cannot read the file: rank 0 is in MPI by then, yet everything ends, with rank 1's line."""
    (place / "lost.toml").mkdir()
    program = place / "program.py"
    program.write_text(
        "import os, sys\n"
        "from rvm_mpi.commands.main import main\n"
        "sys.argv[2] = 'job.toml' if os.environ['OMPI_COMM_WORLD_RANK'] == '0' else 'lost.toml'\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    start = time.monotonic()
    done = mpirun(
        2, program, "run", "?", "--set", "time.end=1e3", cwd=place, env={"PYTHONPATH": str(ROOT)}, timeout=30
    )
    assert time.monotonic() - start < 15
    assert done.returncode == 2, done
    assert spoken(done) == ["rvm: rank 1: lost.toml: is a directory, not a job file"]


@pytest.mark.parametrize("failing", [0, 1])
def test_an_exception_on_one_rank_ends_all(mpirun, place, failing):
    """The other rank waits in a collective call: without an abort it would wait for ever."""
    log = place / "run.log"
    log.write_text("started\n")
    program = place / "program.py"
    program.write_text(
        "import sys\n"
        "from pathlib import Path\n"
        "from mpi4py import MPI\n"
        "from rvm_mpi.run import failures\n"
        "try:\n"
        f"    if MPI.COMM_WORLD.rank == {failing}:\n"
        "        raise FloatingPointError('pressure lost in\\n cell (3, 4)')\n"
        "    MPI.COMM_WORLD.Barrier()\n"
        "except Exception as error:\n"
        "    failures.write_traceback(error, Path('run.log'))\n"
        "    sys.exit(failures.fail(error))\n"
    )
    done = mpirun(2, program, cwd=place, env={"PYTHONPATH": str(ROOT)}, timeout=30)
    assert done.returncode == 3, done
    assert spoken(done) == [f"rvm: rank {failing}: FloatingPointError: pressure lost in cell (3, 4)"]
    assert "Traceback" not in done.stderr
    assert "Traceback" in log.read_text()


def test_debug_prints_the_traceback(place):
    code = (
        "from rvm_mpi.run import failures\n"
        "try:\n"
        "    1 / 0\n"
        "except Exception as error:\n"
        "    raise SystemExit(failures.fail(error))"
    )
    for debug, printed in (("1", True), ("0", False)):
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=environment(RVM_DEBUG=debug),
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 3
        assert ("Traceback" in done.stderr) == printed
        assert done.stderr.splitlines()[-1] == "rvm: rank 0: ZeroDivisionError: division by zero"


def test_a_wrong_request_found_late_still_ends_all_ranks(mpirun, place):
    """A JobError after MPI has started, on one rank or both, leaves no one waiting and speaks once."""
    program = place / "program.py"
    program.write_text(
        "import sys\n"
        "from mpi4py import MPI\n"
        "from rvm_mpi.run import failures\n"
        "from rvm_mpi.job.job import JobError\n"
        "try:\n"
        "    if MPI.COMM_WORLD.rank >= int(sys.argv[1]):\n"
        "        raise JobError('does not fit')\n"
        "    MPI.COMM_WORLD.Barrier()\n"
        "except JobError as error:\n"
        "    sys.exit(failures.refuse(error))\n"
    )
    for first, line in ((0, "rvm: does not fit"), (1, "rvm: rank 1: does not fit")):
        done = mpirun(2, program, str(first), cwd=place, env={"PYTHONPATH": str(ROOT)}, timeout=30)
        assert done.returncode == 2, done
        assert spoken(done) == [line]
