"""How a command ends when it cannot go on: one line, on every rank at once, with the right exit status.

Until MPI is started ranks know each other only through the launcher (`launch.py`): it ends the job when one process
fails, so rank 0 speaks and leaves, and the others wait to be ended; one that is still there after that speaks for
itself.
"""

from __future__ import annotations

import os
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from rvm_mpi.agree import NotCompiled
from rvm_mpi.job.text import JobError, one_line
from rvm_mpi.output.rundir import ENDED
from rvm_mpi.run.launch import LaunchError, launched
from rvm_mpi.terminal import tell

REFUSED = 2
FAILED = 3
INTERRUPTED = 130  # as a shell has it for Ctrl-C
PATIENCE = 5.0
"""Seconds that a rank other than 0 leaves to rank 0 to say what is wrong for all, and to the launcher to end it:
on a busy machine 1.5 were too few."""


def _communicator() -> Any:
    """The world communicator if MPI runs and has more than one rank, else None."""
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is None or not mpi.Is_initialized() or mpi.Is_finalized() or mpi.COMM_WORLD.Get_size() == 1:
        return None
    return mpi.COMM_WORLD


def refuse(error: JobError) -> int:
    """End a wrong request: one line, from rank 0 unless only another rank saw it; returns exit status 2."""
    rank, communicator = launched().rank, _communicator()
    if communicator is not None:
        rank = communicator.Get_rank()
    if rank > 0:
        time.sleep(PATIENCE)
    if rank == 0:
        tell(f"rvm: {error}")
    elif not isinstance(error, LaunchError):
        tell(f"rvm: rank {rank}: {error}")
    if communicator is not None:
        communicator.Abort(REFUSED)
    return REFUSED


def interrupted() -> int:
    """End after Ctrl-C outside a run, which would take it as a wish to stop: one line; returns exit status 130."""
    if launched().rank == 0:
        tell("rvm: interrupted")
    communicator = _communicator()
    if communicator is not None:
        communicator.Abort(INTERRUPTED)
    return INTERRUPTED


def _rank() -> int:
    communicator = _communicator()
    return communicator.Get_rank() if communicator is not None else launched().rank


def _details(error: BaseException) -> str:
    return "".join(traceback.format_exception(type(error), error, error.__traceback__))


def _in_one_line(error: BaseException) -> str:
    return f"rank {_rank()}: {type(error).__name__}: {one_line(' '.join(str(error).split()))}"


def write_traceback(error: BaseException, log: Path) -> None:
    """Append an error's traceback, and how the run ended, to a log, if that is there and can be written."""
    if log.is_file():
        try:
            with log.open("a", encoding="utf-8", errors="replace") as file:
                file.write(f"rank {_rank()} failed:\n{_details(error)}{ENDED}failed: {_in_one_line(error)}\n")
        except OSError:  # the disk may be what failed
            pass


def fail(error: BaseException) -> int:
    """End a failed run: one line from the failing rank; returns exit status 3.

    Every other rank is ended with it: MPI would leave them waiting for ever; unless they know, when rank 0 speaks for
    all. RVM_DEBUG=1 in the environment prints the traceback.
    """
    communicator = _communicator()
    told = isinstance(error, NotCompiled)
    if told and _rank() > 0:
        return FAILED
    if os.environ.get("RVM_DEBUG", "0") not in ("", "0"):
        tell(_details(error).rstrip())
    tell(f"rvm: {error if told else _in_one_line(error)}")
    if communicator is not None and not told:
        communicator.Abort(FAILED)
    return FAILED
