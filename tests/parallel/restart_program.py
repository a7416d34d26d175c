"""Run under mpirun by test_restart.py: runs and restarts tiny jobs of all kinds in one go.

usage: restart_program.py DIR WHAT CASE...; the cases are those of restart_cases.py. WHAT: "whole" runs each to its last
step into DIR/whole/CASE, "half" to half of them into DIR/half/CASE, "NAME" goes on in DIR/NAME/CASE, where a half was
copied to; "disk-full" goes on with the last rank's disk full at the end.
"""

import resource
import sys
from pathlib import Path

from mpi4py import MPI
from restart_cases import STEPS, make_job

from rvm_mpi.output import checkpoint
from rvm_mpi.run.run import run_job


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
