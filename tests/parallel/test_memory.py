"""What a rank holds at its peak is what `rvm check` says beforehand."""

import pytest
import tomli_w

#: runs a job as `rvm run` does and prints the peak of the rank that has most, with what was said; MB
PROGRAM = """
import sys
from pathlib import Path
from mpi4py import MPI
from rvm_mpi import estimates
from rvm_mpi.cli import main
from rvm_mpi.job import Job
comm, job = MPI.COMM_WORLD, sys.argv[1]
assert main(["run", job, "--output", sys.argv[2], "--overwrite", "--quiet"]) == 0
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
peak = comm.allreduce(int(status["VmHWM"].split()[0]) * 1024, op=MPI.MAX)
said = estimates.memory(Job.from_file(job), comm.size)
if comm.rank == 0:
    print(peak / 1e6, (said.total + said.weights) / 1e6, (said.total - said.libraries) / 1e6)
"""
GRANULAR = {"operator": "granular-es-bgk", "knudsen": 0.01, "restitution": 0.99}
JOBS = {
    "plane": {
        "space": {"cells": [48, 48]},
        "velocity": {"points": [24, 24, 8]},
        "collision": GRANULAR,
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
        "initial": {"state": "uniform"},
    },
    "boltzmann": {
        "space": {"cells": [48, 48]},
        "velocity": {"points": [12, 12, 12]},
        "collision": {"operator": "boltzmann", "knudsen": 0.1, "restitution": 0.9},
        "initial": {"state": "random-density", "low": 0.5},
    },
}


@pytest.mark.timeout(400)
@pytest.mark.parametrize("name", JOBS)
def test_the_peak_of_a_run_is_the_memory_that_check_prints(mpirun, tmp_path, name):
    job = tmp_path / "job.toml"
    times = {"time": {"end": 1e3, "max_steps": 2}, "output": {"times": [0.0, 1e3]}}
    job.write_text(tomli_w.dumps(JOBS[name] | times))
    # the first run may have to compile kernels, which takes memory that later ones do not need
    assert mpirun(1, "-c", PROGRAM, job, tmp_path / "run", timeout=150).returncode == 0
    for ranks in (1, 2):
        done = mpirun(ranks, "-c", PROGRAM, job, tmp_path / "run", timeout=100)
        assert done.returncode == 0, done.stderr
        peak, said, own = map(float, done.stdout.split())
        assert own > 0.1 * peak  # else it is the libraries alone that are compared
        assert said == pytest.approx(peak, rel=0.05), f"on {ranks} ranks"
