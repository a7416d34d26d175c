"""Checkpoints: everything the next step depends on, in one HDF5 file that any number of ranks can read.

`checkpoint-NNNNNNNN.h5`, N the step, holds

- `/g` (ny, nx, block): the distribution, one block of velocities for each cell;
- `/cells` (ny, nx, m): what else belongs to a cell (scaling, carried moments, sums, fluid, initial state);
- `/sides/NAME` (n, 5): rates through the faces of each physical side;
- `/checksum/...`: CRC-32 of each cell's and each face's numbers, so that they do not depend on the ranks;
- `/header`: JSON with the job and all numbers of the run, and its CRC-32; `/complete`: 1, written last.

It is written under another name, checked by all ranks, flushed to disk, renamed, and the folder flushed: a file
with the name of a checkpoint is whole, whatever ends the run. The last two are kept. `restart.py` reads it.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi import __version__
from rvm_mpi.agree import DiskFailure, agreed_on_disk
from rvm_mpi.job.job import Job
from rvm_mpi.output import rundir
from rvm_mpi.output.disk import flush_to_disk
from rvm_mpi.output.hdf5 import check_room, contiguous, import_h5py, open_alone, open_together

if TYPE_CHECKING:
    from rvm_mpi.grid.domain import Domain

FORMAT = 3
KEPT = 2
#: bytes of one read or write at most: MPI-IO counts in 32 bits
CALL = 2**30
SIDES = ("x-lower", "x-upper", "y-lower", "y-upper")

@dataclass(frozen=True)
class State:
    """What the next step depends on: views into a simulation's own arrays, without ghosts.

    Attributes
    ----------
    g : (ny, nx, block) array
        Its rows are contiguous.
    cells : dict of arrays (ny, nx, ...)
        Small fields of the cells.
    sides : dict of arrays (n, 5)
        By name, those physical sides that this rank touches.
    numbers : dict
        What every rank has: numbers, strings, dictionaries of them.
    """

    g: np.ndarray
    cells: dict[str, np.ndarray]
    sides: dict[str, np.ndarray]
    numbers: dict[str, Any]

    def packed(self) -> np.ndarray:
        """The small fields side by side: a copy (ny, nx, m)."""
        ny, nx = self.g.shape[:2]
        return np.concatenate([array.reshape(ny, nx, -1) for array in self.cells.values()], axis=-1)

    def columns(self) -> list[list[Any]]:
        """Names and numbers of entries of the small fields, in their order in `packed`."""
        ny, nx = self.g.shape[:2]
        return [[name, array.size // (ny * nx)] for name, array in self.cells.items()]


def write(state: State, domain: Domain, job: Job, directory: Path, step: int) -> Path:
    """Write a checkpoint; collective. Needs no memory of the size of g.

    Parameters
    ----------
    state : State
    domain : Domain
        Who has which cells.
    job : Job
    directory : Path
        The run directory.
    step : int
        Number of the last step.

    Returns
    -------
    Path
        The checkpoint.

    Raises
    ------
    DiskFailure
        On every rank, if any could not do its part; earlier checkpoints are as they were.
    """
    comm = domain.comm
    path = directory / f"checkpoint-{step:08d}.h5"
    part, wrong = path.with_name(path.name + ".part"), f"{path} cannot be written"
    try:
        with agreed_on_disk(comm, wrong):
            if domain.rank == 0:
                _create(part, state, domain, job)
        with agreed_on_disk(comm, wrong):
            file = open_together(part, comm)
        try:
            with agreed_on_disk(comm, wrong):
                _write_blocks(file, state, domain)
            with agreed_on_disk(comm, wrong):
                file.flush()
        finally:
            with agreed_on_disk(comm, wrong):
                file.close()
        with agreed_on_disk(comm, wrong):
            flush_to_disk(part)
        with agreed_on_disk(comm, wrong):
            if domain.rank == 0:
                with open_alone(part, "r+") as file:
                    file["complete"][()] = 1
                flush_to_disk(part)
                part.replace(path)
                flush_to_disk(directory)
    except DiskFailure:
        if domain.rank == 0:
            with contextlib.suppress(OSError):
                part.unlink()
        raise
    if domain.rank == 0:
        with contextlib.suppress(OSError):
            for old in rundir.checkpoints(directory)[:-KEPT]:
                old.unlink()
    return path


def _create(part: Path, state: State, domain: Domain, job: Job) -> None:
    """Lay out the whole file, without writing the room for the data; header first."""
    h5py = import_h5py()
    nx, ny = domain.cells
    columns = state.columns()
    header = {
        "format": FORMAT,
        "version": __version__,
        "job": job.to_toml(),
        "columns": columns,
        "numbers": state.numbers,
    }
    text = json.dumps(header).encode()
    width = sum(count for _name, count in columns)
    shapes: dict[str, tuple[tuple[int, ...], str]] = {
        "g": ((ny, nx, state.g.shape[-1]), "<f8"),
        "cells": ((ny, nx, width), "<f8"),
        "checksum/g": ((ny, nx), "<u4"),
        "checksum/cells": ((ny, nx), "<u4"),
    }
    for name in _physical_sides(job):
        faces = ny if name[0] == "x" else nx
        shapes[f"sides/{name}"] = ((faces, 5), "<f8")
        shapes[f"checksum/{name}"] = ((faces,), "<u4")
    size = len(text) + sum(int(np.prod(shape)) * np.dtype(kind).itemsize for shape, kind in shapes.values())
    free = os.statvfs(part.parent)
    if free.f_bavail * free.f_frsize < size + 2**20:
        raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}: it needs {size / 1e6:.0f} MB")
    check_room(part, len(text))  # the header's; that for the data is not asked for: some file systems would write it
    # this format has checksums of its own for what HDF5 writes about the data
    with h5py.File(part, "w", libver=("v108", "v108")) as file:
        file["header"] = np.frombuffer(text, dtype=np.uint8)
        file["checksum/header"] = np.uint32(zlib.crc32(text))
        file["complete"] = np.uint8(0)
        layout = contiguous()
        layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        for name, (shape, kind) in shapes.items():
            file.create_dataset(name, shape, kind, dcpl=layout.copy())


def _physical_sides(job: Job) -> list[str]:
    return [name for name in SIDES if name in job.space.sides and job.space.sides[name].kind != "periodic"]


def _write_blocks(file: Any, state: State, domain: Domain) -> None:
    """Numbers of this rank, row by row straight from the arrays, and their checksums."""
    (i0, j0), (nx, ny) = domain.start, domain.local
    for j, i, n in pieces(state.g):
        file["g"][j0 + j, i0 + i : i0 + i + n] = state.g[j, i : i + n]
    here = np.s_[j0 : j0 + ny, i0 : i0 + nx]
    packed = state.packed()
    file["cells"][here] = packed
    file["checksum/g"][here] = checksums(state.g)
    file["checksum/cells"][here] = checksums(packed)
    for name, rates in state.sides.items():
        first, count = (j0, ny) if name[0] == "x" else (i0, nx)
        file[f"sides/{name}"][first : first + count] = rates
        file[f"checksum/{name}"][first : first + count] = checksums(rates)


def pieces(g: np.ndarray) -> Iterator[tuple[int, int, int]]:
    """Row, first cell and number of cells of pieces of g (ny, nx, block) of at most `CALL` bytes."""
    ny, nx, block = g.shape
    most = max(1, CALL // (block * g.itemsize))
    for j in range(ny):
        for i in range(0, nx, most):
            yield j, i, min(most, nx - i)


def checksums(array: np.ndarray) -> np.ndarray:
    """CRC-32 of the numbers along the last axis: (..., m) to (...) of uint32."""
    result = np.empty(array.shape[:-1], dtype=np.uint32)
    for place in np.ndindex(result.shape):
        result[place] = zlib.crc32(np.ascontiguousarray(array[place]).data)
    return result
