"""The Boltzmann weights are in memory once a node, and a rank that cannot make them leaves none waiting."""

import hashlib
from pathlib import Path

import pytest
import tomli_w
from parallel import rank_jobs

from rvm_mpi.collisions.weights import Rows, compute_weights

PROGRAM = Path(__file__).with_name("weights_program.py")


@pytest.mark.parametrize("ranks", [1, 2, 4])
def test_one_copy_made_once(mpirun, ranks):
    """All see the bits made on one rank, and what one rank then writes there."""
    done = mpirun(ranks, PROGRAM, "share")
    assert done.returncode == 0, done.stderr
    expected = hashlib.sha256(compute_weights(Rows.create((10, 12)), 2, 0.7, 0.5)).hexdigest()
    assert done.stdout.split(maxsplit=3) == ["1", "1", expected, "[42.0]\n"]


@pytest.mark.parametrize("ranks", [1, 3])
def test_a_rank_that_fails_tells_the_others(mpirun, ranks):
    done = mpirun(ranks, PROGRAM, "fail")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("1 velocity.points: the Boltzmann operator's weights could not be made")
    assert done.stdout.rstrip().endswith("MemoryError: no room for the weights")


@pytest.mark.parametrize(("case", "words"), [("command", "could not be made"), ("room", "no room for")])
def test_the_command_ends_with_one_line(mpirun, tmp_path, case, words):
    job = tmp_path / "job.toml"
    job.write_text(tomli_w.dumps(rank_jobs.JOBS["boltzmann"]))
    done = mpirun(2, PROGRAM, case, job, "--output", tmp_path / "run")
    assert done.returncode == 2
    lines = [line for line in done.stderr.splitlines() if "rvm:" in line]
    assert len(lines) == 1 and words in lines[0]
    assert "Traceback" not in done.stderr and not (tmp_path / "run").exists()
