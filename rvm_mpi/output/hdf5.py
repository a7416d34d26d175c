"""HDF5 files as all of `output/` uses them: which h5py, how they are opened, room on the disk."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from mpi4py import MPI


def import_h5py() -> Any:
    """h5py: its MPI build inside an MPI program (Debian ships two), whichever there is elsewhere."""
    if "mpi4py.MPI" in sys.modules:
        os.environ.setdefault("H5PY_ALWAYS_USE_MPI", "1")
    import h5py

    return h5py


def parallel_h5py(comm: MPI.Comm) -> Any:
    """h5py for all ranks of a communicator.

    Raises
    ------
    RuntimeError
        Where it cannot write in parallel; says what is missing.
    """
    h5py = import_h5py()
    if comm.size > 1 and not h5py.get_config().mpi:
        raise RuntimeError(
            f"h5py in {Path(h5py.__file__).parent} is built without MPI and cannot write from {comm.size} "
            "ranks: install a parallel one (Debian: python3-h5py-mpi, chosen by H5PY_ALWAYS_USE_MPI=1 in the "
            "environment; conda-forge: h5py=*=mpi*)"
        )
    return h5py


def open_alone(path: Path, mode: str) -> Any:
    """Open in this process alone and without file locks: many file systems have none, and none is needed."""
    h5py = import_h5py()
    try:
        return h5py.File(path, mode, locking=False)
    except (TypeError, ValueError):  # this HDF5 is older than the choice
        return h5py.File(path, mode)


def open_together(path: Path, comm: MPI.Comm) -> Any:
    """Open an existing file for writing, on all ranks; collective."""
    h5py = import_h5py()
    parallel = {"driver": "mpio", "comm": comm} if h5py.get_config().mpi else {"locking": False}
    return h5py.File(path, "r+", **parallel)


def check_room(path: Path, size: int) -> None:
    """Raise OSError unless the disk has room for a file of this size: HDF5 itself crashes if it has not."""
    with path.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, size + 2**20)


def contiguous() -> Any:
    """Properties of a dataset that lies in one piece, with its room taken when it is created."""
    h5py = import_h5py()
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.CONTIGUOUS)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    return properties


class Slabs:
    """Parts of one dataset of an open file, written again and again.

    What HDF5 needs to know of the dataset is looked up once: done for each part anew it costs several times as much as
    to write some cells.

    Parameters
    ----------
    dataset : h5py.Dataset
    """

    def __init__(self, dataset: Any) -> None:
        self._id, self._space = dataset.id, dataset.id.get_space()

    def write(self, start: tuple[int, ...], values: Any) -> None:
        """Write an array, of as many axes as the dataset, with its first element at `start`."""
        from h5py import h5s

        block = np.ascontiguousarray(values, dtype=np.float64)
        self._space.select_hyperslab(start, block.shape)
        self._id.write(h5s.create_simple(block.shape), self._space, block)


def datasets(group: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every dataset below a group, with its name."""
    for name, item in group.items():
        if hasattr(item, "shape"):
            yield prefix + name, item
        else:
            yield from datasets(item, f"{prefix}{name}/")
