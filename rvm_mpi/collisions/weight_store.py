"""The Boltzmann operator's weights, made once: on disk for later runs, in memory once a node.

Large weights are kept in the user's cache directory, $XDG_CACHE_HOME/rvm_mpi or ~/.cache/rvm_mpi, in a file named by a
hash of all that their bits depend on, the source of their formula included, behind a checksum of their own. Files
appear whole or not at all, so any number of runs may start at once. The cache may be deleted at any time; one that
cannot be read, written or trusted costs the time to make the weights, nothing else.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from llvmlite.binding import get_host_cpu_name

from rvm_mpi.cache import cache_directory, write_whole
from rvm_mpi.collisions import weights as boltzmann_weights
from rvm_mpi.collisions.weights import Rows, compute_weights
from rvm_mpi.job.text import JobError, one_line

#: bytes from which weights are stored: these take half a second and more to make, and a thirtieth of that to read
STORED_FROM = 8_000_000
#: bytes that all stored weights may take; beyond it the oldest go
LARGEST_CACHE = 2_000_000_000
DIGEST = hashlib.sha256


def file_name(points: tuple[int, ...], restitution: float, exponent: float) -> str:
    """The name under which weights are stored: a hash of all that their bits depend on."""
    formula = Path(boltzmann_weights.__file__).read_bytes()
    depends_on = (
        *(points, float(restitution).hex(), float(exponent).hex(), np.dtype(float).str, sys.byteorder),
        *(DIGEST(formula).hexdigest(), np.__version__, scipy.__version__, get_host_cpu_name()),
    )
    return DIGEST(repr(depends_on).encode()).hexdigest() + ".weights"


def read(path: Path, weights: np.ndarray) -> bool:
    """Read stored weights into an array; False where there are none, or not those that were written."""
    try:
        with path.open("rb") as file:
            digest = file.read(DIGEST().digest_size)
            whole = file.readinto(weights.data) == weights.nbytes and not file.read(1)
    except OSError:
        return False
    return whole and DIGEST(weights.data).digest() == digest


def write(path: Path, weights: np.ndarray) -> None:
    """Store weights where that is possible, in place of a file that may be there, and make room for them.

    Raises
    ------
    OSError
        The directory cannot be written or the disk is full; nothing is left behind.
    """
    write_whole(path, DIGEST(weights.data).digest(), weights.data)
    files = filter(Path.is_file, path.parent.iterdir())
    newest_first = sorted(files, key=lambda one: one.stat().st_mtime, reverse=True)
    sizes = np.cumsum([one.stat().st_size for one in newest_first])
    for old, size in zip(newest_first[1:], sizes[1:]):
        if size > LARGEST_CACHE:
            old.unlink(missing_ok=True)


def fill(weights: np.ndarray, rows: Rows, points: tuple[int, ...], restitution: float, exponent: float) -> None:
    """The weights (`compute_weights`) into an array: from the cache, else made, and stored where they are large."""
    path = None
    if weights.nbytes >= STORED_FROM:
        with suppress(RuntimeError):
            path = cache_directory() / file_name(points, restitution, exponent)
    if path is not None and read(path, weights):
        return
    weights[:] = compute_weights(rows, len(points), restitution, exponent)
    if path is not None:
        with suppress(OSError):
            write(path, weights)


def shared_weights(comm: Any, points: tuple[int, ...], restitution: float, exponent: float) -> np.ndarray:
    """The weights of a grid, one copy a node, read only; called by all ranks.

    Parameters
    ----------
    comm : MPI communicator
    points : tuple of int
    restitution, exponent : float

    Raises
    ------
    JobError
        On every rank, if the weights could not be made on one node; on one rank of a node at least, if that has no
        room for them.
    """
    rows = Rows.create(points)
    weights, first, synchronise = _once_a_node(comm, rows.weight_bytes)
    synchronise()
    failure = ""
    if first:
        try:
            fill(weights, rows, points, restitution, exponent)
        except Exception as error:  # the other ranks are waiting to hear of it
            failure = f"{type(error).__name__}: {one_line(str(error))}"
    synchronise()
    failures = [text for text in comm.allgather(failure) if text]
    if failures:
        raise JobError(
            f"velocity.points: the Boltzmann operator's weights could not be made (value {list(points)}): {failures[0]}"
        )
    weights.flags.writeable = False
    return weights


def _once_a_node(comm: Any, size: int) -> tuple[np.ndarray, bool, Callable[[], None]]:
    """An array of `size` bytes that the ranks of a node share, whether this rank is to fill it, and how they meet."""
    if comm.size == 1:
        return np.empty(size // 8), True, lambda: None
    from mpi4py import MPI

    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    # never freed: that is collective, and no rank knows when the last of them has let go of the weights
    try:
        window = MPI.Win.Allocate_shared(size if node.rank == 0 else 0, 8, comm=node)
    except MPI.Exception as error:  # on one rank alone, perhaps: the command ends the others
        raise JobError(
            f"velocity.points: no room for {size / 1e6:.3g} MB of Boltzmann weights in the memory that the ranks of a "
            f"node share, often /dev/shm; take fewer points, or one rank ({one_line(str(error))})"
        ) from None
    memory: Any = window.Shared_query(0)[0]
    return np.frombuffer(memory, dtype=float, count=size // 8), node.rank == 0, window.Fence
