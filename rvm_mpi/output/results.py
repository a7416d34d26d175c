"""The results of a run: `fields.h5`, `fields.xdmf` and `history.csv`, written and read here.

`fields.h5` is laid out once, for all snapshots, in contiguous datasets of fixed size filled with NaN; after
that only values are written. So its structure is never half-written, a reader may look at it while the run
goes on, and a full disk is noticed at the start. A snapshot exists when its entry in `/time` is a number: it
is written last.
"""

from __future__ import annotations

import contextlib
import csv
import os
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi.job.text import JobError

if TYPE_CHECKING:
    import xarray
    from mpi4py import MPI

    from rvm_mpi.grid.domain import Domain
    from rvm_mpi.job.job import Job

FIELDS = "fields.h5"
HISTORY = "history.csv"
XDMF = "fields.xdmf"
AXES = ("x", "y", "z")


class DiskFailure(OSError):
    """Something could not be written; raised on every rank, with the same line."""


class DirectoryLost(DiskFailure):
    """The run directory is no longer this run's; raised on every rank, with the same line."""


@dataclass(frozen=True)
class Layout:
    """One dataset of `fields.h5`, as it is in each snapshot (the axis of times comes in front of these).

    Attributes
    ----------
    shape : lengths of the axes; () for one number per snapshot
    axes : their names, such as ("y", "x", "component")
    long_name, units : attributes of the dataset
    """

    shape: tuple[int, ...]
    axes: tuple[str, ...]
    long_name: str
    units: str = "1"


def stores_fluid(job: Job) -> bool:
    """Whether a run of this job stores the macroscopic system's own solution under `/fluid`."""
    return bool(job.fluid.enabled or job.scaling.kind == "macroscopic")


def field_layout(job: Job) -> dict[str, Layout]:
    """The cell fields that every run of `job` stores, by dataset name, in their order in the file."""
    space = tuple(reversed(job.space.cells))
    axes = ("x",) if len(space) == 1 else ("y", "x")[: len(space)]
    d = job.velocity.dimensions

    def density(of: str) -> Layout:
        return Layout(space, axes, f"density of {of}", "reference density")

    def temperature(of: str) -> Layout:
        return Layout(space, axes, f"temperature of {of}", "reference temperature")

    def velocity(of: str) -> Layout:
        return Layout((*space, d), (*axes, "component"), f"mean velocity of {of}", "reference speed")

    f = "the distribution function f"
    layout = {
        "kinetic/density": density(f),
        "kinetic/temperature": temperature(f),
        "kinetic/velocity": velocity(f),
        "kinetic/heat_flux": Layout(
            (*space, d),
            (*axes, "component"),
            "heat flux: 1/2 of the integral of c |c|^2 f over v, c = v - velocity",
            "reference density x speed^3",
        ),
        "kinetic/stress": Layout(
            (*space, d, d),
            (*axes, "component", "other_component"),
            "temperature tensor Theta: the integral of c c^T f over v, divided by the density; "
            "its trace is d times the temperature",
            "reference temperature",
        ),
        "kinetic/pressure_tensor": Layout(
            (*space, d, d),
            (*axes, "component", "other_component"),
            "pressure tensor: the integral of c c^T f over v, density times kinetic/stress; its trace is d times the "
            "pressure",
            "reference pressure",
        ),
        "scaling/omega": Layout(space, axes, "scaling of velocity: v = omega xi", "reference speed"),
    }
    if stores_fluid(job):
        fluid = "the macroscopic system"
        layout["fluid/density"] = density(fluid)
        layout["fluid/temperature"] = temperature(fluid)
        layout["fluid/velocity"] = velocity(fluid)
    if job.output.marginals:
        layout["marginal/x"] = Layout(
            (*space, job.velocity.points[0]),
            (*axes, "xi_x"),
            "first marginal of g: the integral of g over all velocity components but xi_x",
            "reference density",
        )
    return layout


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
    reopen : go on writing into an existing file of the same layout (restart)
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
        reopen: bool = False,
        resume: bool = False,
    ):
        self.path = Path(path)
        self.comm = comm
        self.layout = {**field_layout(job), **(extra or {})}
        self._cell_fields = set(field_layout(job))
        self._block = _block(domain)
        self._local = (domain.local[1], domain.local[0])
        h5py = _parallel_h5py(comm)

        error: Exception | None = None
        rows, stored = [float(t) for t in job.output.times], None
        if comm.rank == 0:
            try:
                root = {**attributes, "title": job.title, "job": job.text}
                if resume:
                    rows = _resume(self.path, self.layout, _coordinates(job, xi_x), rows, root)
                elif reopen:
                    _check_same(self.path, self.layout, job)
                else:
                    _create(self.path, self.layout, _coordinates(job, xi_x), len(rows), root)
                with _open(self.path, "r") as file:
                    stored = file["time"][()]
            except Exception as caught:  # whatever it is, the other ranks must hear of it
                error = caught
        self._agree(error, "be opened for this job" if reopen or resume else "be created")
        self.rows: list[float]
        self.stored: np.ndarray
        self.rows, self.stored = comm.bcast((rows, stored))

        parallel = {"driver": "mpio", "comm": comm} if h5py.get_config().mpi else {"locking": False}
        error = None
        try:
            self._file = h5py.File(self.path, "r+", **parallel)
        except Exception as caught:
            error = caught
        self._agree(error, "be opened by all ranks")

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
        if 0 <= index < len(self.stored) and np.isfinite(self.stored[index]):
            self._write_time(index, float("nan"), what)
        error: Exception | None = None
        try:
            self._write_blocks(index, fields, extra or {})
        except Exception as caught:
            error = caught
        self._agree(error, what)
        self._flush(what)
        self._write_time(index, time, what)
        self.rows[index] = time

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
            dataset = self._file[name]
            per_cell = self.layout[name].shape[len(self._block) :]
            expected = (*self._local, *per_cell)
            if np.shape(values) != expected:
                raise ValueError(f"{name} has shape {np.shape(values)}, this rank's block is {expected}")
            where = (index, *self._block, *(slice(0, n) for n in per_cell))
            block = expected[2 - len(self._block) :]
            dataset[where] = np.ascontiguousarray(values, dtype=np.float64).reshape(block)
        for name, (part, values) in extra.items():
            if name in self._cell_fields or name not in self.layout:
                raise ValueError(f"{name} is not one of the extra datasets")
            self._file[name][(index, *part)] = np.asarray(values, dtype=np.float64)

    def _write_time(self, index: int, time: float, what: str):
        error: Exception | None = None
        if self.comm.rank == 0:
            try:
                self._file["time"][index] = time
            except Exception as caught:
                error = caught
        self._agree(error, what)
        self._flush(what)
        self.stored[index] = time

    def _flush(self, what: str):
        error: Exception | None = None
        try:
            self._file.flush()
        except Exception as caught:
            error = caught
        self._agree(error, what)

    def _agree(self, error: Exception | None, what: str):
        """Raise on every rank if any rank has an error."""
        from mpi4py import MPI

        told = self.comm.allgather(None if error is None else (MPI.COMM_WORLD.Get_rank(), _one_line(error)))
        failed = min((one for one in told if one is not None), default=None)
        if failed is not None:
            who = f" (rank {failed[0]})" if self.comm.size > 1 else ""
            raise DiskFailure(f"{self.path} cannot {what}: {failed[1]}{who}") from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _block(domain: Domain) -> tuple[slice, ...]:
    """Cells of this rank in a dataset's space axes, in (y, x) order, one for each space dimension."""
    (i0, j0), (nx, ny) = domain.start, domain.local
    return (slice(j0, j0 + ny), slice(i0, i0 + nx))[2 - domain.dimensions :]


def _lower(job: Job) -> tuple[float, ...]:
    return tuple(job.space.lower or ())


def _times(job: Job) -> int:
    """The number of snapshots the job asks for."""
    return len(job.output.times or ())


def _coordinates(job: Job, xi_x: np.ndarray | None) -> dict[str, np.ndarray]:
    """Cell centres in space and, where marginals are stored, in xi_x."""
    coordinates = {
        axis: lower + (np.arange(n) + 0.5) * h
        for axis, n, lower, h in zip(AXES, job.space.cells, _lower(job), job.space.spacing, strict=False)
    }
    if job.output.marginals:
        n, half_width = job.velocity.points[0], job.velocity.half_width[0]
        centres = -half_width + (np.arange(n) + 0.5) * (2 * half_width / n)
        coordinates["marginal/xi_x"] = centres if xi_x is None else np.asarray(xi_x, dtype=np.float64)
    return coordinates


def _import_h5py() -> Any:
    """h5py: its MPI build inside an MPI program (Debian ships two), whichever there is elsewhere."""
    if "mpi4py.MPI" in sys.modules:
        os.environ.setdefault("H5PY_ALWAYS_USE_MPI", "1")
    import h5py

    return h5py


def _parallel_h5py(comm: MPI.Comm) -> Any:
    h5py = _import_h5py()
    if comm.size > 1 and not h5py.get_config().mpi:
        raise RuntimeError(
            f"h5py in {Path(h5py.__file__).parent} is built without MPI and cannot write from {comm.size} "
            "ranks: install a parallel one (Debian: python3-h5py-mpi, chosen by H5PY_ALWAYS_USE_MPI=1 in the "
            "environment; conda-forge: h5py=*=mpi*)"
        )
    return h5py


def _open(path: Path, mode: str) -> Any:
    """Open in this process alone and without file locks: many file systems have none, and none is needed."""
    h5py = _import_h5py()
    try:
        return h5py.File(path, mode, locking=False)
    except (TypeError, ValueError):  # this HDF5 is older than the choice
        return h5py.File(path, mode)


def _create(
    path: Path,
    layout: Mapping[str, Layout],
    coordinates: Mapping[str, np.ndarray],
    times: int,
    root: Mapping[str, Any],
):
    """Lay out the whole file and fill it with NaN under another name, then give it its own."""
    h5py = _import_h5py()
    part = path.with_name(path.name + ".part")
    datasets = {"time": Layout((), (), "time; NaN: not yet there", "reference length / speed"), **layout}
    numbers = times * sum(int(np.prod(entry.shape, dtype=int)) for entry in datasets.values())
    try:
        check_room(part, 8 * (numbers + sum(map(np.size, coordinates.values()))))
        with _open(part, "w") as file:
            for name, value in root.items():
                file.attrs[name] = value
            properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            properties.set_layout(h5py.h5d.CONTIGUOUS)
            properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
            for name, entry in datasets.items():
                shape = (times, *entry.shape)
                dataset = file.create_dataset(
                    name, shape, np.float64, fillvalue=np.nan, dcpl=properties.copy()
                )
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


def check_room(path: Path, size: int):
    """Raise OSError unless the disk has room for a file of this size: HDF5 itself crashes if it has not."""
    with path.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, size + 2**20)


def _check_same(path: Path, layout: Mapping[str, Layout], job: Job):
    """Raise ValueError unless the file has these datasets and as many snapshots as the job."""
    times = _times(job)
    with _open(path, "r") as file:
        for name, entry in {"time": Layout((), (), ""), **layout}.items():
            shape = file[name].shape if name in file else None
            if shape != (times, *entry.shape):
                raise ValueError(f"{name} has shape {shape} in the file, {(times, *entry.shape)} in the job")


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
    with _open(path, "r") as file:
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
    with _open(path, "r") as old:
        stored = old["time"][()].tolist()
        kept = {t: row for row, t in enumerate(stored) if np.isfinite(t)}
        rows = sorted({*kept, *wanted})
        fits = all(name in old and old[name].shape == (len(rows), *entry.shape) for name, entry in layout.items())
        if fits and all(rows[row] == t for t, row in kept.items()):
            return rows
        whole = {**_stored_layout(old), **layout}
        try:
            _create(new, whole, {**_stored_coordinates(old), **coordinates}, len(rows), root)
            with _open(new, "r+") as file:
                for t, row in kept.items():
                    for name in (name for name in whole if name in old):
                        file[name][rows.index(t)] = old[name][row]
                    file["time"][rows.index(t)] = t
            with new.open("rb") as descriptor:
                os.fsync(descriptor.fileno())
            new.replace(path)
        except BaseException:
            new.unlink(missing_ok=True)
            raise
    return rows


def _stored_layout(file: Any) -> dict[str, Layout]:
    """The datasets of a file that have an entry for each snapshot, such as marginals that are no longer asked for."""
    found = {}
    for name, dataset in _datasets(file):
        axes = tuple(str(dataset.attrs["axes"]).split())
        if axes[0] == "time" and name != "time":
            found[name] = Layout(dataset.shape[1:], axes[1:], dataset.attrs["long_name"], dataset.attrs["units"])
    return found


def _stored_coordinates(file: Any) -> dict[str, np.ndarray]:
    return {name: data[()] for name, data in _datasets(file) if str(data.attrs["axes"]).split()[0] != "time"}


def open_run(directory: str | Path) -> xarray.Dataset:
    """The snapshots of a run, finished or not, in memory. Needs no MPI.

    Parameters
    ----------
    directory : the run directory, or its `fields.h5`

    Returns
    -------
    xarray.Dataset : every dataset of `fields.h5` under its name with underscores (`kinetic/density` is
        `kinetic_density`), with the times that exist, dimensions time, y, x and component, and the attributes
        of the file.

    Raises
    ------
    FileNotFoundError : there is no `fields.h5`.
    """
    import xarray

    path = Path(directory)
    if path.is_dir():
        path = path / FIELDS
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; is {path.parent} a run directory?")
    with _open(path, "r") as file:
        time = file["time"][()]
        exists = np.flatnonzero(np.isfinite(time))
        coordinates: dict[str, Any] = {}
        variables: dict[str, Any] = {}
        for name, dataset in _datasets(file):
            attributes = dict(dataset.attrs)
            axes = attributes.pop("axes").split()
            values = dataset[exists] if axes[0] == "time" and len(exists) else dataset[()]
            if axes[0] == "time" and not len(exists):
                values = values[:0]
            if axes == [name.split("/")[-1]]:
                coordinates[axes[0]] = (axes, values, attributes)
            else:
                attributes["path"] = f"/{name}"
                variables[name.replace("/", "_").replace("-", "_")] = (axes, values, attributes)
        for axis in ("component", "other_component"):
            lengths = [np.shape(v[1])[v[0].index(axis)] for v in variables.values() if axis in v[0]]
            coordinates[axis] = list(AXES[: lengths[0]])
        return xarray.Dataset(variables, coordinates, dict(file.attrs))


@contextlib.contextmanager
def _named(path: str | Path) -> Iterator[None]:
    """An error of the disk names the file, which Python leaves out when writing fails after opening."""
    try:
        yield
    except OSError as error:
        raise OSError(f"{path} cannot be written: {error.strerror or error}") from error


def _datasets(group: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, item in group.items():
        if hasattr(item, "shape"):
            yield prefix + name, item
        else:
            yield from _datasets(item, f"{prefix}{name}/")


class History:
    """`history.csv`: one row per time step, written by rank 0 alone.

    Parameters
    ----------
    path : the file
    columns : their names, fixed for the whole run; "step" is written as an integer, all others with repr,
        which reads back as the same float
    resume_after : keep an existing file's rows up to this step and go on from there (restart); a last row
        that was cut off is dropped

    Raises
    ------
    ValueError : the existing file has other columns.
    """

    def __init__(self, path: str | Path, columns: Sequence[str], resume_after: int | None = None):
        self.path = Path(path)
        self.columns = tuple(columns)
        header = ",".join(self.columns) + "\n"
        bad = any("," in name or name.split() != [name] for name in self.columns)
        if bad or len(set(self.columns)) != len(self.columns):
            raise ValueError(f"not fit for the columns of a CSV file: {header.strip()}")
        lines = [header]
        if resume_after is not None:
            lines = self.path.read_text(encoding="ascii").splitlines(keepends=True)
            if lines[:1] != [header]:
                found = lines[0].strip() if lines else "none"
                raise ValueError(f"{self.path} has other columns than this run: {found}")
            step = self.columns.index("step")
            whole = (line for line in lines[1:] if line.endswith("\n"))
            lines[1:] = [line for line in whole if int(line.split(",")[step]) <= resume_after]
        part = self.path.with_name(self.path.name + ".part")
        with _named(self.path):
            with part.open("w", encoding="ascii") as file:
                file.writelines(lines)
                file.flush()
                os.fsync(file.fileno())  # a crash of the machine must leave one of the two, whole
            part.replace(self.path)
        # without a buffer a row that could not be written is not tried again
        self._file = self.path.open("ab", buffering=0)

    def append(self, row: Mapping[str, float]):
        """Append one row, which must have exactly the columns; it is on its way to disk when this returns.

        Raises
        ------
        ValueError : a column is missing or unknown.
        OSError : it cannot be written.
        """
        if len(row) != len(self.columns) or any(name not in row for name in self.columns):
            wrong = ", ".join(sorted(set(row) ^ set(self.columns)))
            raise ValueError(f"{self.path}: these columns are missing or unknown: {wrong}")
        cells = (str(int(row[name])) if name == "step" else repr(float(row[name])) for name in self.columns)
        line = (",".join(cells) + "\n").encode("ascii")
        with _named(self.path):
            written = self._file.write(line)
            if written < len(line):  # the disk took a part of it: why, it says when asked for more
                self._file.write(line[written:])

    def close(self):
        """Close the file."""
        self._file.close()


def read_history(directory: str | Path) -> dict[str, np.ndarray]:
    """The columns of `history.csv`, each an array with an entry per row; a last row cut off is ignored.

    Raises
    ------
    FileNotFoundError : there is none.
    """
    path = Path(directory)
    if path.is_dir():
        path = path / HISTORY
    text = path.read_text(encoding="ascii")
    rows = list(csv.reader(text[: text.rfind("\n") + 1].splitlines()))
    table = np.array(rows[1:], dtype=np.float64).reshape(-1, len(rows[0]))
    return dict(zip(rows[0], table.T, strict=True))


class Xdmf:
    """`fields.xdmf`: describes `fields.h5`, beside it, to ParaView and VisIt. For rank 0.

    XDMF version 2, cell data, rectangular mesh. One row of cells stands for one space dimension, one cell for none.
    With three velocity dimensions velocity and heat flux are vectors and the stress is a tensor; with fewer, their
    components are scalars. Marginals and walls are not described.

    A new snapshot is written over the file's last lines, which follow it again: what it costs does not grow with the
    number of those before.

    Parameters
    ----------
    path : the file
    job : Job
    stored : times of the snapshots in the order of `fields.h5`, NaN for those that are not there; if there are any,
        the file is written
    """

    HEAD = (
        "<?xml version='1.0' encoding='utf-8'?>\n"
        '<Xdmf Version="2.2">\n  <Domain>\n'
        '    <Grid Name="rvm_mpi" GridType="Collection" CollectionType="Temporal">\n'
    )
    TAIL = "    </Grid>\n  </Domain>\n</Xdmf>\n"

    def __init__(self, path: str | Path, job: Job, stored: Sequence[float] | np.ndarray) -> None:
        self._path, self._job = Path(path), job
        self._times = [float(time) for time in stored]
        self._size = -1
        if np.isfinite(self._times).any():
            self._write()

    def add(self, index: int, time: float) -> None:
        """Describe one more snapshot.

        Parameters
        ----------
        index : its place in `fields.h5`
        time : its time

        Raises
        ------
        OSError : it cannot be written; the file is then as it was.
        """
        if self._times[index] == time:
            return
        last = not np.isfinite(self._times[index:]).any()
        self._times[index] = time
        if last and self._size == self._size_there():
            self._append(index)
        else:
            self._write()

    def _size_there(self) -> int:
        try:
            return self._path.stat().st_size
        except FileNotFoundError:
            return -2

    def _write(self) -> None:
        """The whole file, replaced in one step."""
        part = self._path.with_name(self._path.name + ".part")
        with _named(self._path):
            with part.open("w", encoding="utf-8") as file:
                file.write(self.HEAD)
                file.writelines(self._grid(index) for index, time in enumerate(self._times) if np.isfinite(time))
                file.write(self.TAIL)
            part.replace(self._path)
        self._size = self._size_there()

    def _append(self, index: int) -> None:
        begin = self._size - len(self.TAIL)
        text = (self._grid(index) + self.TAIL).encode()
        with _named(self._path), self._path.open("r+b", buffering=0) as file:
            try:
                file.seek(begin)
                while text:
                    text = text[file.write(text) :]
                self._size = file.tell()
            except OSError:
                with contextlib.suppress(OSError):
                    file.seek(begin)
                    file.write(self.TAIL.encode())
                    file.truncate(self._size)
                self._times[index] = float("nan")
                raise

    def _grid(self, index: int) -> str:
        """The lines on one snapshot."""
        job = self._job
        nx, ny = (*job.space.cells, 1, 1)[:2]
        lower = (*_lower(job), 0.0, 0.0)[:2]
        spacing = (*job.space.spacing, 1.0, 1.0)[:2]
        if job.space.dimensions == 1:
            spacing = (spacing[0], spacing[0])
        number: dict[str, Any] = {"NumberType": "Float", "Precision": "8"}
        grid = ET.Element("Grid", Name=f"snapshot {index}", GridType="Uniform")
        ET.SubElement(grid, "Time", Value=repr(self._times[index]))
        # not 2DCoRectMesh: VTK's reader takes its axes for y and z
        ET.SubElement(grid, "Topology", TopologyType="2DRectMesh", Dimensions=f"{ny + 1} {nx + 1}")
        geometry = ET.SubElement(grid, "Geometry", GeometryType="VXVY")
        for n, first, h in ((nx, lower[0], spacing[0]), (ny, lower[1], spacing[1])):
            item = ET.SubElement(geometry, "DataItem", Dimensions=f"{n + 1}", **number, Format="XML")
            item.text = " ".join(repr(first + i * h) for i in range(n + 1))
        for name, layout in field_layout(job).items():
            if name != "marginal/x":
                _xdmf_field(grid, name, layout, (len(self._times), index), (ny, nx), job.space.dimensions)
        ET.indent(grid, level=3)
        return f"      {ET.tostring(grid, encoding='unicode')}\n"


def _xdmf_field(
    grid: ET.Element,
    name: str,
    layout: Layout,
    snapshot: tuple[int, int],
    cells: tuple[int, int],
    dimensions: int,
):
    """Add a field of one snapshot: whole if a scalar or of three components, else component by component."""
    title = name.replace("/", " ").replace("_", " ")
    space, components = layout.shape[:dimensions], layout.shape[dimensions:]
    kind = {(): "Scalar", (3,): "Vector", (3, 3): "Tensor"}.get(components)
    size = f"{cells[0]} {cells[1]}"
    whole = (snapshot[0], *layout.shape)
    if kind:
        attribute = ET.SubElement(grid, "Attribute", Name=title, AttributeType=kind, Center="Cell")
        entries = f" {int(np.prod(components))}" if components else ""
        start = (snapshot[1], *(0 for _ in layout.shape))
        _xdmf_slab(attribute, name, size + entries, whole, start, (1, *layout.shape))
        return
    for component in np.ndindex(*components):
        if list(component) != sorted(component):  # a tensor here is symmetric
            continue
        label = "".join(AXES[k] for k in component)
        attribute = ET.SubElement(
            grid, "Attribute", Name=f"{title} {label}", AttributeType="Scalar", Center="Cell"
        )
        start = (snapshot[1], *(0 for _ in space), *component)
        _xdmf_slab(attribute, name, size, whole, start, (1, *space, *(1 for _ in component)))


def _xdmf_slab(
    attribute: ET.Element,
    name: str,
    size: str,
    whole: tuple[int, ...],
    start: tuple[int, ...],
    count: tuple[int, ...],
):
    """Add the part of a dataset that begins at `start` and has the shape `count`, seen as of shape `size`."""
    number: dict[str, Any] = {"NumberType": "Float", "Precision": "8"}
    slab = ET.SubElement(attribute, "DataItem", ItemType="HyperSlab", Dimensions=size, **number, Format="HDF")
    choice = ET.SubElement(slab, "DataItem", Dimensions=f"3 {len(whole)}", NumberType="Int", Format="XML")
    choice.text = " ".join(map(str, (*start, *(1 for _ in whole), *count)))
    data = ET.SubElement(slab, "DataItem", Dimensions=" ".join(map(str, whole)), **number, Format="HDF")
    data.text = f"{FIELDS}:/{name}"
