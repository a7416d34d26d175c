"""Run under mpirun by test_results_parallel.py: writes a run directory with the package's own job and domain.

usage: results_program.py DIR CELLS CASE, CELLS such as 12x9, 9 or 0D
"""

import os
import resource
import signal
import sys
from pathlib import Path

import numpy as np
from mpi4py import MPI

from rvm_mpi.exact_sum import exact_sums
from rvm_mpi.grid.domain import Domain
from rvm_mpi.job.job import Job
from rvm_mpi.output.fields import FieldsFile
from rvm_mpi.output.layout import Layout, field_layout

comm = MPI.COMM_WORLD


def make_job(cells):
    return Job.from_dict(
        {
            "title": "parallel",
            "space": {"cells": cells},
            "velocity": {"points": [8, 6, 4], "half_width": 7.0},
            "collision": {"operator": "es-bgk", "knudsen": 0.1},
            "fluid": {"enabled": True},
            "initial": {"state": "uniform"},
            "time": {"end": 2.0},
            "output": {"times": [0.0, 0.5, 2.0], "marginals": True},
        }
    )


def fields(job, domain, snapshot):
    """Numbers that depend on the global cell alone."""
    (i0, j0), (nx, ny) = domain.start, domain.local
    y, x = np.meshgrid(np.arange(j0, j0 + ny), np.arange(i0, i0 + nx), indexing="ij")
    result = {}
    for number, (name, layout) in enumerate(field_layout(job).items()):
        per_cell = layout.shape[job.space.dimensions :]
        inner = np.arange(int(np.prod(per_cell, dtype=int))).reshape(per_cell)
        base = (x + 1000 * y + 1e6 * number + snapshot / 3).reshape(ny, nx, *(1 for _ in per_cell))
        result[name] = base + inner / 128
    return result


def limit_file_size(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


def main():
    directory, cells, case = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
    job = make_job([] if cells == "0D" else [int(n) for n in cells.split("x")])
    domain = Domain(job, comm)
    last = comm.rank == comm.size - 1
    extra = {}
    if "x" in cells:
        extra["wall/x-lower/pressure"] = Layout((job.space.cells[1],), ("y",), "pressure")
    if case == "no-room" and comm.rank == 0:
        limit_file_size(10_000)
    with FieldsFile(directory / "fields.h5", comm, domain, job, {"version": "0"}, extra) as file:
        for snapshot, time in enumerate(job.output.times):
            values = fields(job, domain, snapshot)
            shares = {}
            if extra and domain.start[0] == 0:
                part = slice(domain.start[1], domain.start[1] + domain.local[1])
                shares["wall/x-lower/pressure"] = ((part,), np.arange(job.space.cells[1])[part] + snapshot)
            if snapshot == 1 and case in ("one-fails", "disk-fails"):
                if last and case == "one-fails":
                    values.pop("kinetic/density")
                if last and case == "disk-fails":
                    limit_file_size(1_000)
                try:
                    file.write(snapshot, time, values, shares)
                except OSError as error:
                    os.write(1, f"CAUGHT {comm.rank} {error}\n".encode())  # in one piece, for the ranks share a stream
                limit_file_size(resource.RLIM_INFINITY)
                continue
            file.write(snapshot, time, values, shares)
            if case == "killed" and snapshot == 1:
                comm.Barrier()
                os.kill(os.getpid(), signal.SIGKILL)
    density = [fields(job, domain, snapshot)["kinetic/density"].ravel() for snapshot in range(3)]
    table = np.stack(density, axis=1) / 3
    sums = exact_sums(table, comm)
    if comm.rank == 0:
        print("SUMS", " ".join(value.hex() for value in sums))


try:
    main()
except OSError as error:
    os.write(1, f"CAUGHT {comm.rank} {error}\n".encode())  # in one piece, for the ranks share a stream
