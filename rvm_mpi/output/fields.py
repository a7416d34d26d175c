"""`fields.h5`: the snapshots of a run, written by all ranks.

The file is laid out once, for all snapshots, in contiguous datasets of fixed size filled with NaN; after
that only values are written. So its structure is never half-written, a reader may look at it while the run
goes on, and a full disk is noticed at the start. A snapshot exists when its entry in `/time` is a number: it
is written last.

That order holds for whoever reads the file, and for a run that is killed. For a machine that loses its power the values
must be on disk before the time is sent there, which costs as much as many steps of a small job: it is done once a
second and before each checkpoint. Snapshots that come faster than that may then be incomplete; the run that goes on
from its checkpoint takes them again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi.agree import agreed_on_disk
from rvm_mpi.job.text import JobError
from rvm_mpi.output.disk import flush_to_disk
from rvm_mpi.output.hdf5 import Slabs, check_room, contiguous, datasets, open_alone, open_together, parallel_h5py
from rvm_mpi.output.layout import AXES, Layout, coordinates_of, field_layout

if TYPE_CHECKING:
    from mpi4py import MPI

    from rvm_mpi.grid.domain import Domain
    from rvm_mpi.job.job import Job

#: seconds from one snapshot that is put on disk at once to the next
TO_DISK_EVERY = 1.0


class FieldsFile:
    """The snapshots of a run in one HDF5 file, every rank writing its own block.

    Rank 0 alone creates the file, completely, under another name; then all ranks open it. Blocks are written
    independently: with contiguous datasets that is a few large writes per rank, and a rank that fails leaves
    no other waiting. All ranks must call `write` and `close`.

    Parameters
    ----------
    path : the file, usually `DIR/fields.h5`
    comm : MPI communicator
    domain : the cells of this rank: `dimensions`, `start` (i0, j0), `local` (nx, ny)
    job : the job; its fields are those of `field_layout`
    attributes : attributes of the root: title and job text are added
    extra : more datasets by name, such as "wall/x-lower/pressure", with their layout
    xi_x : (points,) velocity nodes of the marginal; cell centres of the velocity box if None
    resume : go on with an existing file (restart). Every snapshot that it holds is kept; where the job asks for more
        of them, or for more of each, they are copied into a file that is laid out anew

    Attributes
    ----------
    rows : list of float
        For each place in the file, in rising order, the time of the snapshot that is there or is wanted.
    stored : (n,) array
        Times of the snapshots that are there, NaN for the others.

    Raises
    ------
    DiskFailure : if the file cannot be created or opened, or fits another job.
    RuntimeError : h5py cannot write in parallel here; says what is missing.
    """

    def __init__(
        self,
        path: str | Path,
        comm: MPI.Comm,
        domain: Domain,
        job: Job,
        attributes: Mapping[str, Any],
        extra: Mapping[str, Layout] | None = None,
        xi_x: np.ndarray | None = None,
        resume: bool = False,
    ):
        self.path = Path(path)
        self.comm = comm
        self.layout = {**field_layout(job), **(extra or {})}
        self._cell_fields = set(field_layout(job))
        self._block = _block(domain)
        self._local = (domain.local[1], domain.local[0])
        parallel_h5py(comm)

        rows, stored = [float(t) for t in job.output.times], None
        with self._agreed("be opened for this job" if resume else "be created"):
            if comm.rank == 0:
                root = {**attributes, "title": job.title, "job": job.text}
                if resume:
                    rows = _resume(self.path, self.layout, coordinates_of(job, xi_x), rows, root)
                else:
                    _create(self.path, self.layout, coordinates_of(job, xi_x), len(rows), root)
                with open_alone(self.path, "r") as file:
                    stored = file["time"][()]
        self.rows: list[float]
        self.stored: np.ndarray
        self.rows, self.stored = comm.bcast((rows, stored))
        with self._agreed("be opened by all ranks"):
            self._file = open_together(self.path, comm)
            #: HDF5 gives what it writes in parallel to the system at once
            self._buffers = self._file.driver != "mpio"
            self._slabs = {name: Slabs(self._file[name]) for name in ("time", *self.layout)}
        self._to_disk_from = monotonic()

    def _agreed(self, what: str) -> AbstractContextManager[None]:
        return agreed_on_disk(self.comm, f"{self.path} cannot {what}")

    def write(
        self,
        index: int,
        time: float,
        fields: Mapping[str, np.ndarray],
        extra: Mapping[str, Any] | None = None,
    ):
        """Write snapshot number `index`: this rank's block of every field, and when all is on disk, its time.

        Parameters
        ----------
        index : its place in `rows`
        time : time of the snapshot
        fields : by dataset name, arrays (ny, nx, ...) of this rank's cells without ghosts, always two space
            axes
        extra : by dataset name, this rank's share of an extra dataset as a pair: where, a tuple of slices of
            one snapshot, and the values; names of which this rank has nothing are left out

        Raises
        ------
        DiskFailure : if any rank cannot write its part; the snapshot then does not exist.
        """
        what = f"take snapshot {index} at t = {time:g}"
        again = 0 <= index < len(self.stored) and bool(np.isfinite(self.stored[index]))
        to_disk = again or self.comm.bcast(monotonic() >= self._to_disk_from)
        if again:
            self._write_time(index, float("nan"), what, to_disk)
        with self._agreed(what):
            self._write_blocks(index, fields, extra or {})
        self._flush(what, to_disk)
        self._write_time(index, time, what, to_disk)
        self.rows[index] = time
        if to_disk:
            self._to_disk_from = monotonic() + TO_DISK_EVERY

    def close(self):
        """Close the file on all ranks; a second call does nothing."""
        if self._file:
            self._file.close()

    def __enter__(self) -> FieldsFile:
        return self

    def __exit__(self, *_: object):
        self.close()

    def _write_blocks(self, index: int, fields: Mapping[str, np.ndarray], extra: Mapping[str, Any]):
        if not 0 <= index < len(self.stored):
            raise IndexError(f"the file has room for {len(self.stored)} snapshots")
        if set(fields) != self._cell_fields:
            wrong = ", ".join(sorted(set(fields) ^ self._cell_fields))
            raise ValueError(f"these fields are missing or unknown: {wrong}")
        for name, values in fields.items():
            per_cell = self.layout[name].shape[len(self._block) :]
            expected = (*self._local, *per_cell)
            if np.shape(values) != expected:
                raise ValueError(f"{name} has shape {np.shape(values)}, this rank's block is {expected}")
            start = (index, *(part.start for part in self._block), *(0 for _ in per_cell))
            self._slabs[name].write(start, np.reshape(values, (1, *expected[2 - len(self._block) :])))
        for name, (part, values) in extra.items():
            if name in self._cell_fields or name not in self.layout:
                raise ValueError(f"{name} is not one of the extra datasets")
            start = (index, *(axis.start or 0 for axis in part), *(0 for _ in np.shape(values)[len(part) :]))
            self._slabs[name].write(start, np.asarray(values)[np.newaxis])

    def _write_time(self, index: int, time: float, what: str, to_disk: bool):
        with self._agreed(what):
            if self.comm.rank == 0:
                self._slabs["time"].write((index,), np.array([time]))
        self._flush(what, to_disk)
        self.stored[index] = time

    def _flush(self, what: str, to_disk: bool):
        """Let what was written leave this process, where HDF5 keeps it in a buffer, or reach the disk. Collective."""
        if to_disk or self._buffers:
            with self._agreed(what):
                self._file.flush()


def _block(domain: Domain) -> tuple[slice, ...]:
    """Cells of this rank in a dataset's space axes, in (y, x) order, one for each space dimension."""
    (i0, j0), (nx, ny) = domain.start, domain.local
    return (slice(j0, j0 + ny), slice(i0, i0 + nx))[2 - domain.dimensions :]


def _create(
    path: Path,
    layout: Mapping[str, Layout],
    coordinates: Mapping[str, np.ndarray],
    times: int,
    root: Mapping[str, Any],
):
    """Lay out the whole file and fill it with NaN under another name, then give it its own."""
    part = path.with_name(path.name + ".part")
    entries = {"time": Layout((), (), "time; NaN: not yet there", "reference length / speed"), **layout}
    numbers = times * sum(int(np.prod(entry.shape, dtype=int)) for entry in entries.values())
    try:
        check_room(part, 8 * (numbers + sum(map(np.size, coordinates.values()))))
        with open_alone(part, "w") as file:
            for name, value in root.items():
                file.attrs[name] = value
            for name, entry in entries.items():
                shape = (times, *entry.shape)
                dataset = file.create_dataset(name, shape, np.float64, fillvalue=np.nan, dcpl=contiguous())
                _describe(dataset, ("time", *entry.axes), entry.long_name, entry.units)
            for name, values in coordinates.items():
                file[name] = values
                axis = name.split("/")[-1]
                units = "reference length" if axis in AXES else "reference speed / omega"
                _describe(file[name], (axis,), f"cell centres in {axis}", units)
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def _describe(dataset: Any, axes: tuple[str, ...], long_name: str, units: str):
    dataset.attrs["axes"] = " ".join(axes)
    dataset.attrs["long_name"] = long_name
    dataset.attrs["units"] = units


def check_times(path: Path, job: Job, time: float):
    """Refuse a restart that wants a snapshot of a time that the run has passed without taking one.

    Parameters
    ----------
    path : `fields.h5`
    time : time of the checkpoint; a time that is now to be stored may be new

    Raises
    ------
    JobError : naming the time.
    OSError : the file cannot be read.
    """
    with open_alone(path, "r") as file:
        stored = set(file["time"][()].tolist())
    for t in job.output.times:
        if t < time and t not in stored:
            raise JobError(
                f"{job.name}: output.times: t = {t:g} was not stored before the checkpoint at t = {time:g}, and cannot "
                "be any more; only later times can be added"
            )


def _resume(
    path: Path,
    layout: Mapping[str, Layout],
    coordinates: Mapping[str, np.ndarray],
    wanted: Sequence[float],
    root: Mapping[str, Any],
) -> list[float]:
    """Make room for what is wanted beside every snapshot that is there; the times of all, in rising order.

    What the run was computing when it ended it computes again: a snapshot that was taken after the checkpoint is
    written once more when the run comes to its time. Until then the old one stays.
    """
    new = path.with_name(path.name + ".new")
    for left in (new, new.with_name(new.name + ".part"), path.with_name(path.name + ".part")):
        left.unlink(missing_ok=True)  # of a restart that was killed
    with open_alone(path, "r") as old:
        stored = old["time"][()].tolist()
        kept = {t: row for row, t in enumerate(stored) if np.isfinite(t)}
        rows = sorted({*kept, *wanted})
        fits = all(name in old and old[name].shape == (len(rows), *entry.shape) for name, entry in layout.items())
        if fits and all(rows[row] == t for t, row in kept.items()):
            return rows
        whole = {**_stored_layout(old), **layout}
        try:
            _create(new, whole, {**_stored_coordinates(old), **coordinates}, len(rows), root)
            with open_alone(new, "r+") as file:
                for t, row in kept.items():
                    for name in (name for name in whole if name in old):
                        file[name][rows.index(t)] = old[name][row]
                    file["time"][rows.index(t)] = t
            flush_to_disk(new)
            new.replace(path)
        except BaseException:
            new.unlink(missing_ok=True)
            raise
    return rows


def _stored_layout(file: Any) -> dict[str, Layout]:
    """The datasets of a file that have an entry for each snapshot, such as marginals that are no longer asked for."""
    found = {}
    for name, dataset in datasets(file):
        axes = tuple(str(dataset.attrs["axes"]).split())
        if axes[0] == "time" and name != "time":
            found[name] = Layout(dataset.shape[1:], axes[1:], dataset.attrs["long_name"], dataset.attrs["units"])
    return found


def _stored_coordinates(file: Any) -> dict[str, np.ndarray]:
    return {name: data[()] for name, data in datasets(file) if str(data.attrs["axes"]).split()[0] != "time"}
