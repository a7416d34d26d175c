"""What a checkpoint costs, beside a plain parallel write and flush of as many bytes on the same disk, in turn.

    mpirun -n 2 .venv/bin/python benchmarks/checkpoint_cost.py [DIR]

DIR (by default the present directory) says which disk; what is written there is removed. The plain write: every rank
writes its part of one file with MPI-IO in one call, and flushes it to disk. The checkpoint: `checkpoint.write`, with
its checksums, both flushes, the renaming and the flush of the folder. 150 MB, that is 64 x 64 cells of 24 x 24 x 8.
"""

import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

from rvm_mpi import Simulation
from rvm_mpi.job.job import Job
from rvm_mpi.output import checkpoint

TURNS = 7
JOB = {
    "space": {"cells": [64, 64]},
    "velocity": {"points": [24, 24, 8]},
    "collision": {"operator": "granular-es-bgk", "knudsen": 0.01, "restitution": 0.99},
    "fluid": {"enabled": True},
    "initial": {"state": "random-density", "low": 0.1},
    "time": {"end": 1.0},
}


def plain_write(comm, path, part):
    """Every rank its part, one after the other in one file, in one call; then to disk."""
    file = MPI.File.Open(comm, str(path), MPI.MODE_CREATE | MPI.MODE_WRONLY)
    file.Write_at(comm.rank * part.nbytes, part)
    file.Close()
    checkpoint.flush_to_disk(path)


def seconds(comm, action):
    comm.Barrier()
    begin = time.perf_counter()
    action()
    comm.Barrier()
    return time.perf_counter() - begin


def main():
    comm = MPI.COMM_WORLD
    where = sys.argv[1] if len(sys.argv) > 1 else "."
    simulation = Simulation(Job.from_dict(JOB))
    state = simulation.state()
    folder = tempfile.mkdtemp(dir=where) if comm.rank == 0 else ""
    directory = Path(comm.bcast(folder))
    part = np.ascontiguousarray(state.g)
    figures = []
    for turn in range(TURNS):
        beside = directory / f"plain-{turn}"
        plain = seconds(comm, lambda beside=beside: plain_write(comm, beside, part))
        ours = seconds(
            comm, lambda turn=turn: checkpoint.write(state, simulation.domain, simulation.job, directory, turn)
        )
        figures.append((plain, ours))
        if comm.rank == 0:
            size = (directory / f"checkpoint-{turn:08d}.h5").stat().st_size / 1e6
            print(f"{size:.1f} MB: plain {plain:.3f} s, checkpoint {ours:.3f} s, {ours / plain:.2f} x", flush=True)
            beside.unlink()
    if comm.rank == 0:
        plain, ours = np.median(figures, axis=0)
        print(f"medians on {comm.size} ranks: plain {plain:.3f} s, checkpoint {ours:.3f} s, {ours / plain:.2f} x")
        shutil.rmtree(directory)


if __name__ == "__main__":
    main()
