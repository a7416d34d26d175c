"""The one agreement of all ranks on an error: what one of them raises, all raise, with the same words.

A rank that raised alone would leave the others waiting for it in their next collective call, for ever. So what may fail
on some ranks only is done by all within `agreed`, `agreed_on_disk` or `on_rank_0`. Within them no rank may wait for
another: one that fails comes to their end at once.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np

from rvm_mpi.job.text import JobError

T = TypeVar("T")


class NotCompiled(RuntimeError):
    """The kernels could not be compiled; raised on every rank, with the same line."""


class DiskFailure(OSError):
    """Something could not be written; raised on every rank, with the same line."""


def raise_on_all(comm: Any, error: Exception | None) -> None:
    """If any rank has an error, raise on every rank that of the first of them, as launched. Collective.

    Parameters
    ----------
    comm : MPI communicator
    error : Exception or None
        What this rank has; it goes to the others pickled.
    """
    if comm.size == 1:
        if error is not None:
            raise error
        return
    from mpi4py import MPI

    anywhere = np.array([error is not None], dtype=np.int32)
    comm.Allreduce(MPI.IN_PLACE, anywhere, op=MPI.MAX)
    if anywhere[0]:  # all of them are exchanged only then: this is called after every step
        told = comm.allgather(None if error is None else (MPI.COMM_WORLD.Get_rank(), error))
        _rank, first = min((one for one in told if one is not None), key=lambda one: one[0])
        raise first from (None if error is None else error.__cause__)


@contextlib.contextmanager
def agreed(comm: Any, failure: Callable[[str], Exception]) -> Iterator[None]:
    """A block that all ranks come to; whatever any of them raises in it, all raise at its end. Collective.

    Parameters
    ----------
    comm : MPI communicator
    failure : callable
        Makes what is raised from the line that says what went wrong.
    """
    error: Exception | None = None
    try:
        yield
    except Exception as caught:  # whatever it is, the other ranks must hear of it
        error = failure(" ".join(str(caught).split()) or type(caught).__name__)
        error.__cause__ = caught
    raise_on_all(comm, error)


@contextlib.contextmanager
def agreed_on_disk(comm: Any, what: str) -> Iterator[None]:
    """The same for what is written: all raise DiskFailure, "WHAT: why (rank N)".

    Parameters
    ----------
    comm : MPI communicator
    what : str
        Such as "runs/x/fields.h5 cannot be created".
    """

    def failure(why: str) -> DiskFailure:
        if comm.size == 1:
            return DiskFailure(f"{what}: {why}")
        from mpi4py import MPI

        return DiskFailure(f"{what}: {why} (rank {MPI.COMM_WORLD.Get_rank()})")

    with agreed(comm, failure):
        yield


def on_rank_0(comm: Any, action: Callable[[], T]) -> T | None:
    """Do something on rank 0; if it cannot, every rank raises the same error. Collective.

    Parameters
    ----------
    comm : MPI communicator
    action : callable
        May raise JobError, or an OSError, which becomes a DiskFailure. Anything else is an error of the program, which
        rank 0 raises alone: it ends the run on all.

    Returns
    -------
    What `action` returns; None on other ranks.
    """
    result: T | None = None
    error: Exception | None = None
    if comm.rank == 0:
        try:
            result = action()
        except (JobError, DiskFailure) as caught:
            error = caught
        except OSError as caught:
            error = DiskFailure(str(caught))
    raise_on_all(comm, error)
    return result
