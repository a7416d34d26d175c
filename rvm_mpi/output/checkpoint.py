"""Checkpoints: everything the next step depends on, in one HDF5 file that any number of ranks can read.

`checkpoint-NNNNNNNN.h5`, N the step, holds

- `/g` (ny, nx, block): the distribution, one block of velocities for each cell;
- `/cells` (ny, nx, m): what else belongs to a cell (scaling, carried moments, sums, fluid, initial state);
- `/sides/NAME` (n, 5): rates through the faces of each physical side;
- `/checksum/...`: CRC-32 of each cell's and each face's numbers, so that they do not depend on the ranks;
- `/header`: JSON with the job and all numbers of the run, and its CRC-32; `/complete`: 1, written last.

It is written under another name, checked by all ranks, flushed to disk, renamed, and the folder flushed: a file
with the name of a checkpoint is whole, whatever ends the run. The last two are kept.
"""

from __future__ import annotations

import contextlib
import errno
import gc
import json
import os
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from rvm_mpi import __version__
from rvm_mpi.job.job import Job, JobError
from rvm_mpi.job.text import parse_toml
from rvm_mpi.output import rundir
from rvm_mpi.output.results import DiskFailure, _import_h5py, _open, check_room

if TYPE_CHECKING:
    from rvm_mpi.grid.domain import Domain

FORMAT = 3
KEPT = 2
#: bytes of one read or write at most: MPI-IO counts in 32 bits
CALL = 2**30
SIDES = ("x-lower", "x-upper", "y-lower", "y-upper")

T = TypeVar("T")


class DamagedCheckpoint(OSError):
    """A file with the name of a checkpoint that cannot be used; raised on every rank."""


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


# -- writing ----------------------------------------------------------------------------------------------


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
    part = path.with_name(path.name + ".part")
    try:
        with agreed(domain, path):
            if domain.rank == 0:
                _create(part, state, domain, job)
        with agreed(domain, path):
            h5py = _import_h5py()
            parallel = {"driver": "mpio", "comm": comm} if h5py.get_config().mpi else {"locking": False}
            file = h5py.File(part, "r+", **parallel)
        try:
            with agreed(domain, path):
                _write_blocks(file, state, domain)
            with agreed(domain, path):
                file.flush()
        finally:
            with agreed(domain, path):
                file.close()
        with agreed(domain, path):
            flush_to_disk(part)
        with agreed(domain, path):
            if domain.rank == 0:
                with _open(part, "r+") as file:
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


def flush_to_disk(path: Path) -> None:
    """Return when a file, or the list of files of a folder, is on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def agreed(domain: Domain, path: Path) -> Iterator[None]:
    """All ranks do something; if any of them fails, all raise DiskFailure with the same line."""
    from mpi4py import MPI

    error: Exception | None = None
    try:
        yield
    except Exception as caught:  # whatever it is, the other ranks must hear of it
        error = caught
    told = domain.comm.allgather(None if error is None else (MPI.COMM_WORLD.Get_rank(), _one_line(error)))
    failed = min((one for one in told if one is not None), default=None)
    if failed is not None:
        who = f" (rank {failed[0]})" if domain.size > 1 else ""
        raise DiskFailure(f"{path} cannot be written: {failed[1]}{who}") from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _create(part: Path, state: State, domain: Domain, job: Job) -> None:
    """Lay out the whole file, without writing the room for the data; header first."""
    h5py = _import_h5py()
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
        layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        layout.set_layout(h5py.h5d.CONTIGUOUS)
        layout.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        layout.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
        for name, (shape, kind) in shapes.items():
            file.create_dataset(name, shape, kind, dcpl=layout.copy())


def _physical_sides(job: Job) -> list[str]:
    return [name for name in SIDES if name in job.space.sides and job.space.sides[name].kind != "periodic"]


def _write_blocks(file: Any, state: State, domain: Domain) -> None:
    """Numbers of this rank, row by row straight from the arrays, and their checksums."""
    (i0, j0), (nx, ny) = domain.start, domain.local
    for j, i, n in _pieces(state.g):
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


def _pieces(g: np.ndarray) -> Iterator[tuple[int, int, int]]:
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


# -- reading ----------------------------------------------------------------------------------------------


def read_header(file: Any) -> dict[str, Any]:
    """The header of an open file: job, columns and numbers as they were written.

    Raises
    ------
    ValueError, KeyError
        If it is no checkpoint, or not whole.
    """
    if int(file["complete"][()]) != 1:
        raise ValueError("it was not written to its end")
    text = file["header"][()].tobytes()
    if zlib.crc32(text) != int(file["checksum/header"][()]):
        raise ValueError("the checksum of its header does not fit")
    header: dict[str, Any] = json.loads(text)
    if header["format"] != FORMAT:
        raise ValueError(f"it has format {header['format']}; rvm {__version__} reads format {FORMAT}")
    return header


class Checkpoint:
    """A complete checkpoint, open on every rank.

    Parameters
    ----------
    path : Path
    comm : MPI communicator

    Attributes
    ----------
    job : Job
        The job it belongs to.
    numbers : dict
        `State.numbers` as they were written.

    Raises
    ------
    DamagedCheckpoint
        On every rank, if it cannot be used; so do the methods that read.
    """

    def __init__(self, path: Path, comm: Any) -> None:
        self.path, self._comm = path, comm
        self._file: Any = None
        self._agree(self._read_header)

    def __enter__(self) -> Checkpoint:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()

    def _read_header(self) -> None:
        # every rank opens it for itself: nothing here waits for others
        self._file = _open(self.path, "r")
        header = read_header(self._file)
        self.numbers: dict[str, Any] = header["numbers"]
        self._job, self._columns = header["job"], header["columns"]

    @property
    def job(self) -> Job:
        """The job as it was run."""
        return Job.from_dict(parse_toml(self._job, str(self.path)), str(self.path))

    def check_job(self, job: Job) -> None:
        """JobError, the same on every rank, if `job` differs in a key that a restart may not change."""
        differing = rundir.differing_keys(self.job, job)
        if differing:
            raise JobError(f"{self.path}: belongs to another job: {'; '.join(differing)}")

    def cells(self, domain: Domain) -> dict[str, np.ndarray]:
        """The small fields of this rank's cells: arrays (ny, nx, m) by name."""
        (i0, j0), (nx, ny) = domain.start, domain.local
        packed = np.empty((ny, nx, sum(count for _name, count in self._columns)))

        def read() -> None:
            here = np.s_[j0 : j0 + ny, i0 : i0 + nx]
            packed[...] = self._file["cells"][here]
            self._compare(checksums(packed), "cells", here)

        self._agree(read)
        ends = np.cumsum([count for _name, count in self._columns])
        return {name: packed[..., end - count : end] for (name, count), end in zip(self._columns, ends)}

    def fill(self, state: State, domain: Domain) -> None:
        """Read this rank's part into the arrays of `state`."""
        for name, values in self.cells(domain).items():
            state.cells[name][...] = values.reshape(state.cells[name].shape)
        (i0, j0), (nx, ny) = domain.start, domain.local

        def read() -> None:
            dataset = self._file["g"]
            for j, i, n in _pieces(state.g):
                dataset.read_direct(state.g[j, i : i + n], np.s_[j0 + j, i0 + i : i0 + i + n])
            self._compare(checksums(state.g), "g", np.s_[j0 : j0 + ny, i0 : i0 + nx])
            for name, rates in state.sides.items():
                first, count = (j0, ny) if name[0] == "x" else (i0, nx)
                rates[...] = self._file[f"sides/{name}"][first : first + count]
                self._compare(checksums(rates), name, np.s_[first : first + count])

        self._agree(read)

    def _compare(self, found: np.ndarray, name: str, where: Any) -> None:
        wrong = np.argwhere(found != self._file[f"checksum/{name}"][where])
        if wrong.size:
            first = where if isinstance(where, tuple) else (where,)
            place = tuple(int(w) + part.start for w, part in zip(wrong[0], first))[::-1]
            text = f"cell ({place[0]}, {place[1]})" if len(place) == 2 else f"face {place[0]} of {name}"
            raise ValueError(f"the checksum of {text} does not fit ({name})")

    def _agree(self, action: Callable[[], None]) -> None:
        error: Exception | None = None
        try:
            action()
        except Exception as caught:
            error = caught
        told = self._comm.allgather(None if error is None else _one_line(error))
        first = next((line for line in told if line is not None), None)
        if first is not None:
            self.__exit__()
            raise DamagedCheckpoint(f"{self.path} is damaged: {first}") from error


def use_newest(directory: Path, comm: Any, use: Callable[[Checkpoint], T]) -> tuple[T, list[str]]:
    """Do something with the newest checkpoint that is whole; collective.

    Parameters
    ----------
    directory : Path
        The run directory.
    comm : MPI communicator
    use : callable
        Takes a `Checkpoint`; called again with the one before if that raises DamagedCheckpoint.

    Returns
    -------
    result of `use`, list of str
        With lines on what was found damaged or half-written. Damaged files are out of the way, renamed to
        NAME.damaged; half-written ones are gone.

    Raises
    ------
    JobError
        If there is none that can be used.
    """
    listed = (rundir.checkpoints(directory), sorted(directory.glob("checkpoint-*.h5.part"))) if comm.rank == 0 else None
    paths, halves = comm.bcast(listed)
    damaged: list[tuple[Path, str]] = []
    for path in reversed(paths):
        result, complaint = _try(path, comm, use)
        if complaint:
            damaged.append((path, complaint))
            gc.collect()  # the arrays of this attempt go before there are new ones
            continue
        lines = [f"{half} was left half-written and is not used" for half in halves]
        lines += [line for _path, line in damaged]
        if damaged:
            lines.append(f"going on from {path}, the one before")
        if comm.rank == 0:
            with contextlib.suppress(OSError):
                for half in halves:
                    half.unlink()
                for bad, _line in damaged:
                    bad.replace(bad.with_name(bad.name + ".damaged"))
        return result, lines  # type: ignore[return-value]
    found = "; ".join(line for _path, line in damaged) or "it holds no checkpoint"
    if halves:
        found += f"; {halves[-1].name} is half-written"
    raise JobError(f"{directory}: nothing to restart from: {found}")


def _try(path: Path, comm: Any, use: Callable[[Checkpoint], T]) -> tuple[T | None, str]:
    """The result of `use`, or what is wrong with the checkpoint."""
    try:
        with Checkpoint(path, comm) as checkpoint:
            return use(checkpoint), ""
    except DamagedCheckpoint as error:
        return None, str(error)
