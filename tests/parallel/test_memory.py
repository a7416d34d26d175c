"""What a rank holds at its peak is what `rvm check` says beforehand."""

import pytest
import tomli_w

from rvm_mpi.advice import memory

PROGRAM = """
import sys
from pathlib import Path
from mpi4py import MPI
from rvm_mpi.advice import memory
from rvm_mpi.commands.main import main
from rvm_mpi.job.job import Job
comm, job = MPI.COMM_WORLD, sys.argv[1]
assert main(["run", job, "--output", sys.argv[2], "--overwrite", "--quiet"]) == 0
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
peak = comm.allreduce(int(status["VmHWM"].split()[0]) * 1024, op=MPI.MAX)
said = memory.memory(Job.from_file(job), comm.size)
if comm.rank == 0:
    print(peak, said.total - said.libraries + said.weights)
"""
GRANULAR = {"operator": "granular-es-bgk", "knudsen": 0.01, "restitution": 0.99}
JOBS = {
    "plane": {
        "space": {"cells": [48, 48]},
        "velocity": {"points": [24, 24, 8]},
        "collision": GRANULAR,
        "fluid": {"enabled": True},
        "initial": {"state": "random-density", "low": 0.2},
    },
    "many cells": {
        "space": {"cells": [256, 192]},
        "velocity": {"points": [8, 8]},
        "collision": GRANULAR,
        "initial": {"state": "random-density", "low": 0.2},
    },
    "slab": {
        "space": {"cells": [400], "boundary": {"x": "diffuse"}},
        "velocity": {"points": [32, 16, 16]},
        "collision": GRANULAR,
        "fluid": {"enabled": True},
        "initial": {"state": "uniform"},
    },
    "boltzmann": {
        "space": {"cells": [48, 48]},
        "velocity": {"points": [12, 12, 12]},
        "collision": {"operator": "boltzmann", "knudsen": 0.1, "restitution": 0.9, "coarse": True},
        "initial": {"state": "random-density", "low": 0.5},
    },
}


SMALL = {
    "space": {"cells": [12, 12]},
    "velocity": {"points": [8, 8, 8]},
    "collision": GRANULAR,
    "initial": {"state": "uniform"},
}
RANKS = (1, 2)


def peaks(mpirun, directory, job):
    """Peak and the arrays' share of it as foretold, on each number of ranks; bytes."""
    file = directory / "job.toml"
    file.write_text(tomli_w.dumps(job | {"time": {"end": 1e3, "max_steps": 2}, "output": {"times": [0.0, 1e3]}}))
    # the first run may have to compile kernels, which takes memory that later ones do not need
    assert mpirun(1, "-c", PROGRAM, file, directory / "run", timeout=150).returncode == 0
    found = {}
    for ranks in RANKS:
        done = mpirun(ranks, "-c", PROGRAM, file, directory / "run", timeout=100)
        assert done.returncode == 0, done.stderr
        found[ranks] = tuple(map(float, done.stdout.split()))
    return found


@pytest.fixture(scope="module")
def libraries(mpirun, tmp_path_factory):
    """What this machine's libraries take on each number of ranks: the peak of a job that has hardly any arrays."""
    small = peaks(mpirun, tmp_path_factory.mktemp("small"), SMALL)
    return {ranks: peak - arrays for ranks, (peak, arrays) in small.items()}


@pytest.mark.timeout(400)
@pytest.mark.parametrize("name", JOBS)
def test_the_peak_of_a_run_is_the_memory_that_check_prints(mpirun, tmp_path, libraries, name):
    for ranks, (peak, arrays) in peaks(mpirun, tmp_path, JOBS[name]).items():
        assert arrays > 0.1 * peak
        assert libraries[ranks] + arrays == pytest.approx(peak, rel=0.05), f"on {ranks} ranks"


@pytest.mark.timeout(400)
def test_libraries(libraries):
    """Other versions of them take something else: the figure is that of Debian 12."""
    for ranks, measured in libraries.items():
        assert pytest.approx(measured, rel=0.25) == memory.LIBRARIES, f"on {ranks} ranks"
