"""Checkpoints read again, on any number of ranks; what is damaged is put aside (`checkpoint.py` writes them)."""

from __future__ import annotations

import contextlib
import gc
import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from rvm_mpi import __version__
from rvm_mpi.agree import agreed
from rvm_mpi.job.job import Job, JobError
from rvm_mpi.job.text import parse_toml
from rvm_mpi.output import rundir
from rvm_mpi.output.checkpoint import FORMAT, State, checksums, pieces
from rvm_mpi.output.hdf5 import open_alone

if TYPE_CHECKING:
    from rvm_mpi.grid.domain import Domain

T = TypeVar("T")


class DamagedCheckpoint(OSError):
    """A file with the name of a checkpoint that cannot be used; raised on every rank."""


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
        self._file = open_alone(self.path, "r")
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
            for j, i, n in pieces(state.g):
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
        try:
            with agreed(self._comm, lambda why: DamagedCheckpoint(f"{self.path} is damaged: {why}")):
                action()
        except DamagedCheckpoint:
            self.__exit__()
            raise


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
