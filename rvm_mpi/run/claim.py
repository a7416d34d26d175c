"""A run directory held by one run, for all its ranks (`output/lock.py`), and what is found when it is lost."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from rvm_mpi.agree import DiskFailure, on_rank_0
from rvm_mpi.job.text import JobError
from rvm_mpi.output.lock import FILE, Lock, Owner, read
from rvm_mpi.run.failures import write_traceback


class DirectoryLost(DiskFailure):
    """The run directory is no longer this run's; raised on every rank, with the same line."""


class Claim:
    """A run directory held by a run, for all its ranks: a context, entered by all together.

    Parameters
    ----------
    directory : Path
        Made, with those above it, where it is not there; gone again if the run ends by an error that has left it empty.
    comm : MPI communicator

    Attributes
    ----------
    lock : Lock or None
        On rank 0.

    Raises
    ------
    JobError
        On every rank, if another run has it or this one cannot.
    """

    def __init__(self, directory: Path, comm: Any) -> None:
        self.directory, self._comm = directory, comm
        self.lock: Lock | None = None
        self._made: list[Path] = []
        comm.Barrier()  # some rank may still be looking whether the directory is free
        self._owner = comm.bcast(on_rank_0(comm, self._take))

    def _take(self) -> Owner:
        try:
            self._made = _make(self.directory)
            self.lock = Lock(self.directory)
        except JobError:
            self._unmake()
            raise
        except OSError as error:
            self._unmake()
            raise JobError(f"{self.directory}: cannot be used: {error.strerror or error}") from None
        return self.lock.owner

    def _unmake(self) -> None:
        for path in reversed(self._made):
            with contextlib.suppress(OSError):
                path.rmdir()

    def held(self) -> bool:
        """Whether the directory of that name is still this run's, as far as this rank sees."""
        return read(self.directory / FILE) == self._owner

    def check(self) -> None:
        """Before anything is written by its name; collective.

        Raises
        ------
        DirectoryLost
            On every rank, if the directory was moved or another run has taken it.
        """
        on_rank_0(self._comm, self._check)

    def _check(self) -> None:
        if lost := self.lost():
            raise DirectoryLost(lost)

    def lost(self) -> str:
        """That and why the directory is no longer this run's; empty if it is."""
        if self.held():
            return ""
        other = read(self.directory / FILE)
        why = f"{other.named()} has it" if other else "it was moved, or its lock removed"
        return f"{self.directory} is no longer this run's: {why}; nothing more is written"

    def note(self, error: Exception) -> None:
        """Put the traceback of an error that nobody expected into the directory's `run.log`."""
        with contextlib.suppress(OSError):
            if self.held():
                write_traceback(error, self.directory / "run.log")

    def __enter__(self) -> Claim:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self.lock is not None:
            self.lock.release()
            if kind is not None:
                self._unmake()


def _make(directory: Path) -> list[Path]:
    """Make a directory; those that were not there, the uppermost first."""
    missing = [path for path in (directory, *directory.parents) if not path.exists()][::-1]
    directory.mkdir(parents=True, exist_ok=True)
    return missing
