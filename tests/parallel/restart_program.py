"""Run under mpirun by test_restart.py: runs and restarts tiny jobs of all kinds in one go.

usage: restart_program.py DIR WHAT CASE...; WHAT: "whole" runs each case to its last step into DIR/whole/CASE, "half"
to half of them into DIR/half/CASE, "NAME" goes on in DIR/NAME/CASE, where a half was copied to; "disk-full" goes on
with the last rank's disk full at the end.
"""

import resource
import sys
from pathlib import Path

from mpi4py import MPI

from rvm_mpi import checkpoint
from rvm_mpi.job import Job
from rvm_mpi.simulation import run_job

STEPS = 6
GRANULAR = {"operator": "granular-es-bgk", "knudsen": 0.2, "restitution": 0.9}
RANDOM = {"state": "random-density", "low": 0.5, "seed": 4}
WAVE = {"state": "wave", "density_amplitude": 0.2, "temperature_amplitude": 0.2}
WALL = {"kind": "maxwell", "accommodation": 0.7, "temperature": 1.2, "velocity": [0.0, 0.1]}

CASES = {
    "0d": {"space": {"cells": []}, "collision": GRANULAR, "initial": {"state": "uniform", "velocity": [0.3, 0.0]}},
    "1d-macroscopic": {
        "space": {"cells": [11], "boundary": {"x": {"lower": "specular", "upper": "far-field"}}},
        "scaling": {"kind": "macroscopic", "synchronise": 2.0},
        "scheme": {"conservative": False},
        "collision": GRANULAR,
        "initial": RANDOM,
    },
    "1d-unscaled": {
        "space": {"cells": [10], "boundary": {"x": {"lower": "vacuum", "upper": "outflow"}}},
        "scaling": {"kind": "none"},
        "collision": {"operator": "none"},
        "initial": WAVE,
        "fluid": {"enabled": False},
    },
    "1d-boltzmann": {
        "space": {"cells": [11], "boundary": {"x": {"lower": "specular", "upper": "diffuse"}}},
        "collision": {"operator": "boltzmann", "knudsen": 0.2, "restitution": 0.95, "penalise": True},
        "initial": WAVE,
    },
    "2d-walls": {
        "space": {"cells": [9, 7], "boundary": {"x": {"lower": WALL, "upper": "far-field"}, "y": "specular"}},
        "collision": GRANULAR,
        "initial": RANDOM,
        "output": {"marginals": True},
    },
    "2d-macroscopic": {
        "space": {"cells": [7, 9]},
        "scaling": {"kind": "macroscopic", "synchronise": "auto"},
        "collision": GRANULAR,
        "initial": RANDOM,
    },
    "2d-kinetic": {
        "space": {"cells": [8, 9], "boundary": {"x": "periodic", "y": {"lower": "outflow", "upper": "diffuse"}}},
        "scheme": {"drift": "kappa"},
        "collision": {"operator": "es-bgk", "knudsen": 0.05},
        "initial": {**WAVE, "mode": [1, 1]},
    },
}


def make_job(case, steps):
    tables = CASES[case]
    output = {"times": [0.0, 0.004, 0.02, 0.9], **tables.get("output", {})}
    changes = {"velocity": {"points": [12, 10]}, "time": {"end": 1.0, "max_steps": steps}, "output": output}
    return Job.from_dict({**tables, **changes}, name=case)


def main():
    top, what, cases = Path(sys.argv[1]), sys.argv[2], sys.argv[3:]
    comm = MPI.COMM_WORLD
    for case in cases:
        restart = what not in ("whole", "half")
        job = make_job(case, STEPS // 2 if what == "half" else STEPS)
        if what == "disk-full" and comm.rank == comm.size - 1:
            fill_the_disk_of(comm)
        status = run_job(job, top / what / case, restart=restart, quiet=what != "disk-full")
        if comm.rank == 0:
            print("STATUS", case, status, flush=True)


def fill_the_disk_of(comm):
    """From its first block on, a checkpoint does not get to this rank's disk."""
    real = checkpoint._write_blocks

    def write(*arguments):
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
        try:
            real(*arguments)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)

    checkpoint._write_blocks = write


main()
