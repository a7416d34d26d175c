"""Peak memory of a rank against what `rvm check` says, and what it is made of.

    .venv/bin/python benchmarks/memory.py [--ranks 1 2 4] [--jobs paper ...]

Every job runs as `rvm run` does, for two steps, with a snapshot and a checkpoint. Peaks are VmHWM of /proc/self/status,
noted by every rank after each part of the run; those of the rank with the highest are printed. RssFile is what the
libraries' files take of it, RssShmem what is shared with other ranks: MPI's segments and the Boltzmann weights. The
kernels must be compiled before (a run that compiles holds more).
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

GRANULAR = {"operator": "granular-es-bgk", "knudsen": 0.01, "restitution": 0.99}
RANDOM = {"state": "random-density", "low": 0.2}
JOBS = {
    "paper": {"space": {"cells": [64, 64]}, "velocity": {"points": [24, 24, 8]}},
    "fine velocities": {"space": {"cells": [24, 24]}, "velocity": {"points": [32, 32, 32]}},
    "many cells": {"space": {"cells": [256, 256]}, "velocity": {"points": [8, 8, 8]}},
    "small": {"space": {"cells": [16, 16]}, "velocity": {"points": [8, 8, 8]}},
    "slab": {"space": {"cells": [400], "boundary": {"x": "diffuse"}}, "velocity": {"points": [32, 16, 16]}},
    "boltzmann": {
        "space": {"cells": [32, 32]},
        "velocity": {"points": [16, 16, 16]},
        "collision": {"operator": "boltzmann", "knudsen": 0.1, "restitution": 0.9},
    },
}


def status() -> dict[str, float]:
    """MB of the kernel's own account of this process."""
    lines = (line.split() for line in Path("/proc/self/status").read_text().splitlines())
    return {words[0][:-1]: int(words[1]) * 1024 / 1e6 for words in lines if words[0].startswith(("VmHWM", "Rss"))}


def of_rank(job: dict) -> None:
    """Run a job on this rank and print its peaks after each part, as a line of JSON on rank 0."""
    from mpi4py import MPI

    marks = {"mpi": status()["VmHWM"]}

    import h5py  # noqa: F401
    from petsc4py import PETSc  # noqa: F401

    from rvm_mpi.advice import memory
    from rvm_mpi.job.job import Job
    from rvm_mpi.run.claim import Claim
    from rvm_mpi.run.control import Control
    from rvm_mpi.run.run import Run
    from rvm_mpi.simulation import Simulation

    comm = MPI.COMM_WORLD
    marks["imports"] = status()["VmHWM"]
    job = Job.from_dict(job, "memory")
    sim = Simulation(job)
    marks["state"] = status()["VmHWM"]
    with tempfile.TemporaryDirectory() as folder:
        output = Path(comm.bcast(folder)) / "run"
        with Control(output) as control, Claim(output, comm) as claim, Run(sim, claim, False, False, quiet=True) as run:
            save = run.save

            def saving() -> None:
                marks["steps, snapshot"] = status()["VmHWM"]
                save()
                marks["checkpoint"] = status()["VmHWM"]

            run.save = saving
            assert run.go(control) == 0
        comm.Barrier()
    end = status()
    mine = {**marks, "VmHWM": end["VmHWM"], "RssFile": end["RssFile"], "RssShmem": end["RssShmem"]}
    worst = max(comm.allgather(mine), key=lambda one: one["VmHWM"])
    if comm.rank == 0:
        said = memory.memory(job, comm.size)
        print(json.dumps(worst | {"said": said.total / 1e6, "weights": said.weights / 1e6}))


def measured(job: dict, ranks: int) -> dict[str, float]:
    """What `of_rank` prints for a job on so many ranks."""
    whole = {
        "collision": GRANULAR,
        "fluid": {"enabled": True},
        "initial": RANDOM,
        **job,
        "time": {"end": 1e3, "max_steps": 2},
        "output": {"times": [0.0, 1e3]},
    }
    mpirun = shutil.which("mpirun.openmpi") or "mpirun"
    command = [mpirun, "-n", str(ranks), "--oversubscribe", "--bind-to", "none", sys.executable, __file__]
    environment = os.environ | {"OMPI_MCA_mpi_yield_when_idle": "1", "H5PY_ALWAYS_USE_MPI": "1"}
    done = subprocess.run(
        [*command, "--job", json.dumps(whole)], env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--jobs", nargs="+", choices=JOBS, default=list(JOBS))
    parser.add_argument("--job", type=json.loads, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.job:
        of_rank(arguments.job)
        return
    names = ("imports", "state", "steps, snapshot", "checkpoint", "VmHWM", "RssFile", "RssShmem", "said", "weights")
    print("| job | ranks | " + " | ".join(names) + " | said/measured |\n" + "| --- " * (len(names) + 3) + "|")
    for name in arguments.jobs:
        for ranks in arguments.ranks:
            found = measured(JOBS[name], ranks)
            figures = " | ".join(f"{found[name]:.0f}" for name in names)
            off = (found["said"] + found["weights"]) / found["VmHWM"] - 1
            print(f"| {name} | {ranks} | {figures} | {off:+.1%} |", flush=True)


if __name__ == "__main__":
    main()
