"""Run under mpirun by test_postmortem_parallel.py: a run whose g is no number in one cell before step STEP.

usage: postmortem_program.py DIR I J STEP; a checkpoint is written after every step.
"""

import math
import sys
from pathlib import Path

from rvm_mpi.job.job import Job
from rvm_mpi.run.run import run_job
from rvm_mpi.simulation import Simulation

JOB = {
    "space": {"cells": [12, 9], "boundary": {"y": "diffuse"}},
    "velocity": {"points": [8, 8]},
    "collision": {"operator": "granular-es-bgk", "knudsen": 0.2, "restitution": 0.9},
    "initial": {"state": "random-density", "low": 0.5},
    "time": {"end": 1.0, "max_steps": 8},
    "output": {"times": [0.0, 1.0], "checkpoint_every": "1e-9 s"},
}


def main():
    directory, (i, j, step) = Path(sys.argv[1]), map(int, sys.argv[2:5])
    advance = Simulation.advance

    def poisoned(self):
        (i0, j0), (nx, ny) = self.domain.start, self.domain.local
        if self.number + 1 == step and 0 <= i - i0 < nx and 0 <= j - j0 < ny:
            self.kinetic.inside(self.kinetic.g)[j - j0, i - i0, 20] = math.nan
        return advance(self)

    Simulation.advance = poisoned
    return run_job(Job.from_dict(JOB, "poisoned"), directory)


if __name__ == "__main__":
    sys.exit(main())
