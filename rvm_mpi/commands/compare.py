"""Two runs, or two checkpoints, number by number: what differs first, and by how much.

Exact means the same bits (a NaN equals a NaN in its place). With a tolerance R a difference counts where it is above R
times the size of its quantity: the largest number of it in either run, or the natural unit of what may be nought but
for rounding, such as the momentum of a gas at rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rvm_mpi.job.job import Job, JobError
from rvm_mpi.job.text import parse_toml
from rvm_mpi.output import checkpoint, rundir
from rvm_mpi.output.results import AXES, FIELDS, HISTORY, _datasets, _open, read_history

#: numbers of a quantity that are read at once, at least one entry of its first axis
PIECE = 2**22


@dataclass(frozen=True)
class Quantity:
    """A named array, read piece by piece along its first axis.

    Attributes
    ----------
    axes : tuple of str
        Names of its axes.
    data : array or HDF5 dataset
        Has a shape, and gives an array for a slice of its first axis.
    """

    axes: tuple[str, ...]
    data: Any

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return tuple(self.data.shape)

    def pieces(self) -> Iterator[slice]:
        """Slices of the first axis."""
        step = max(1, PIECE // max(1, int(np.prod(self.shape[1:], dtype=np.int64))))
        for start in range(0, self.shape[0], step):
            yield slice(start, min(start + step, self.shape[0]))

    def read(self, part: slice) -> np.ndarray:
        """One piece."""
        return np.array(self.data[part], dtype=np.float64)

    def largest(self) -> float:
        """Largest size of its finite numbers."""
        found = 0.0
        for part in self.pieces():
            values = self.read(part)
            found = max(found, float(np.abs(values[np.isfinite(values)]).max(initial=0.0)))
        return found


@dataclass(frozen=True)
class Columns:
    """Some columns of the small fields of a checkpoint, which stand side by side in one dataset (ny, nx, m)."""

    dataset: Any
    begin: int
    end: int

    @property
    def shape(self) -> tuple[int, ...]:
        """(ny, nx, columns)."""
        return (*self.dataset.shape[:2], self.end - self.begin)

    def __getitem__(self, part: slice) -> np.ndarray:
        return np.asarray(self.dataset[part, :, self.begin : self.end])


@dataclass(frozen=True)
class Picked:
    """Some entries of the first axis of a dataset, in rising order."""

    dataset: Any
    entries: Sequence[int]

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the dataset, but for the first axis."""
        return (len(self.entries), *self.dataset.shape[1:])

    def __getitem__(self, part: slice) -> np.ndarray:
        entries = self.entries[part]
        return np.array([self.dataset[k] for k in entries]).reshape(len(entries), *self.shape[1:])


@dataclass(frozen=True)
class Found:
    """How a quantity differs.

    Attributes
    ----------
    first : tuple of int
        Index of the first number that differs (beyond the tolerance).
    values : tuple of two floats
        What stands there.
    largest, relative : float
        Largest difference anywhere, and that over the quantity's size; inf where only one of two is a number.
    worst : tuple of int
        Index of the largest difference.
    """

    first: tuple[int, ...]
    values: tuple[float, float]
    largest: float
    relative: float
    worst: tuple[int, ...]


def distances(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the bits of two float64 arrays differ (NaNs are all one), and the distances of their numbers.

    The distance is inf where one of two is no number or not finite.
    """
    a, b = np.ascontiguousarray(a), np.ascontiguousarray(b)
    differ = (a.view(np.int64) != b.view(np.int64)) & ~(np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.where(differ, np.abs(a - b), 0.0)
    distance[np.isnan(distance)] = np.inf
    return differ, distance


def compare(a: Quantity, b: Quantity, size: float, tolerance: float | None = None) -> Found | None:
    """How two quantities of one shape differ, None if they do not (beyond the tolerance).

    Parameters
    ----------
    a, b : Quantity
    size : float
        What differences are relative to.
    tolerance : float, optional
        Relative; None: the bits.
    """
    first: tuple[int, ...] | None = None
    worst: tuple[int, ...] = ()
    values, largest = (0.0, 0.0), -1.0
    for part in a.pieces():
        one, other = a.read(part), b.read(part)
        differ, distance = distances(one, other)
        if tolerance is not None:
            differ = distance > tolerance * size
        if not differ.any():
            continue
        if first is None:
            place = np.unravel_index(int(np.argmax(differ)), differ.shape)
            first, values = _shifted(place, part), (float(one[place]), float(other[place]))
        place = np.unravel_index(int(np.argmax(distance)), distance.shape)
        if distance[place] > largest:
            worst, largest = _shifted(place, part), float(distance[place])
    if first is None:
        return None
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        relative = float(np.divide(largest, size)) if largest > 0.0 else 0.0
    return Found(first, values, largest, relative, worst)


def _shifted(place: Sequence[Any], part: slice) -> tuple[int, ...]:
    return (int(place[0]) + part.start, *(int(k) for k in place[1:]))


# -- sizes ------------------------------------------------------------------------------------------------


def natural_unit(name: str, largest: Mapping[str, float]) -> float:
    """The unit of a quantity that may be nought but for rounding, from the largest of others; 0 where it has none."""
    group, _, last = name.rpartition("/")
    beside = {key.rpartition("/")[2]: value for key, value in largest.items() if key.rpartition("/")[0] == group}
    if last.endswith("_error") or last in ("correction", "box_mass", "box_energy"):
        return 1.0
    mass, energy = beside.get("mass", 0.0), beside.get("energy", 0.0)
    if "momentum_" in last:
        return float(np.sqrt(mass * energy))
    if last.startswith(("entered_mass", "entered_energy")) or last == "dissipated_energy":
        return mass if last.startswith("entered_mass") else energy
    temperature = beside.get("temperature", 0.0)
    units = {
        "velocity": np.sqrt(temperature),
        "heat_flux": beside.get("density", 0.0) * temperature**1.5,
        "shear_stress": beside.get("pressure", 0.0),
        "min_g": beside.get("max_g", 0.0),
    }
    return float(units.get(last, 0.0))


def sizes(a: Mapping[str, Quantity], b: Mapping[str, Quantity]) -> dict[str, float]:
    """What the differences of each quantity that both have are relative to."""
    largest = {name: max(a[name].largest(), b[name].largest()) for name in a if name in b}
    return {name: max(value, natural_unit(name, largest)) for name, value in largest.items()}


# -- runs and checkpoints -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """What two runs or checkpoints both should have: a file of a run, or all of a checkpoint.

    Attributes
    ----------
    name : str
        Such as "fields.h5".
    a, b : dict of Quantity
        By name, in an order in which what comes first in a run comes first.
    notes : list of str
        What is already known to differ.
    asides : list of str
        What is to be said and is no difference.
    """

    name: str
    a: dict[str, Quantity]
    b: dict[str, Quantity]
    notes: list[str] = field(default_factory=list)
    asides: list[str] = field(default_factory=list)


def compare_paths(a: Path, b: Path, tolerance: float | None = None) -> tuple[bool, list[str]]:
    """Compare two run directories or two checkpoints.

    Parameters
    ----------
    a, b : Path
    tolerance : float, optional
        Relative; None: the bits.

    Returns
    -------
    bool, list of str
        Whether they are the same, and lines on what differs.

    Raises
    ------
    JobError
        If they cannot be compared.
    """
    for path in (a, b):
        if not path.exists():
            raise JobError(f"{path}: no such file or directory")
    if a.is_dir() != b.is_dir():
        raise JobError(f"{a}, {b}: a run directory and a file cannot be compared; two of either can")
    with ExitStack() as stack:
        read = _runs if a.is_dir() else _checkpoints
        try:
            parts, lines = read(a, b, stack, tolerance)
        except (OSError, KeyError, ValueError, IndexError) as error:
            if isinstance(error, JobError):
                raise
            raise JobError(f"{a}, {b}: cannot be read: {' '.join(str(error).split())}") from None
        # whether two jobs agree within a tolerance has no meaning: that they differ is then only said
        same, compared = tolerance is not None or not lines, []
        for part in parts:
            alike, report = _compare_part(part, tolerance)
            same = same and alike
            lines += [f"{part.name}: {line}" for line in part.asides] + report
            compared.append(f"{len(part.a)} of {part.name}")
    how = "bit for bit" if tolerance is None else f"within {tolerance:g}"
    verdict = f"the same {how}" if same else f"not the same {how}"
    return same, [*lines, f"{a} and {b} are {verdict} (quantities: {', '.join(compared)})"]


def _runs(a: Path, b: Path, stack: ExitStack, tolerance: float | None) -> tuple[list[Part], list[str]]:
    for path in (a, b):
        if not rundir.holds_run(path):
            raise JobError(f"{path}: holds no run")
        for name in (HISTORY, FIELDS):
            if not (path / name).is_file():
                raise JobError(f"{path}: has no {name}")
    jobs = [Job.from_file(path / "job.toml") for path in (a, b)]
    lines = _job_lines(*jobs)
    one, other = (stack.enter_context(_open(path / FIELDS, "r")) for path in (a, b))
    wanted = {time for job in jobs for time in job.output.times}
    return [_histories(read_history(a), read_history(b)), _snapshots(one, other, wanted, tolerance or 0.0)], lines


def _histories(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> Part:
    """The rows that both have."""
    rows = [len(next(iter(history.values()))) for history in (a, b)]
    notes = [f"{rows[0]} rows in the first, {rows[1]} in the second"] if rows[0] != rows[1] else []
    cut = [{name: Quantity(("step",), column[: min(rows)]) for name, column in history.items()} for history in (a, b)]
    return Part(HISTORY, cut[0], cut[1], notes)


def _snapshots(a: Any, b: Any, wanted: set[float], tolerance: float) -> Part:
    """The snapshots that two `fields.h5` both have.

    Of one that only one has it is said; it is a difference if one of the jobs asks for its time, and none if it is
    what a run left where it once stopped.
    """
    times = [file["time"][()] for file in (a, b)]
    pairs, single = _pairs(times[0], times[1], tolerance)
    notes, asides = [], []
    for which, k in single:
        time = times[which][k]
        line = f"snapshot {k} (t = {time:g}) is in the {('first', 'second')[which]} only"
        if time in wanted:
            notes.append(line)
        else:
            asides.append(f"{line}, left where that run once stopped")
    found: list[dict[str, Quantity]] = [{}, {}]
    for file, side, entries in zip((a, b), found, zip(*pairs) if pairs else ((), ())):
        for name, dataset in [("time", file["time"]), *_datasets(file)]:
            axes = tuple(str(dataset.attrs["axes"]).split())
            side[name] = Quantity(axes, Picked(dataset, entries) if axes[0] == "time" else dataset)
    return Part(FIELDS, found[0], found[1], notes, asides)


def _pairs(a: np.ndarray, b: np.ndarray, tolerance: float) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Places of the times that two lists share, NaN aside, and those of which only one has: (0 or 1, place)."""
    here, there = ([int(k) for k in np.flatnonzero(np.isfinite(times))] for times in (a, b))
    slack = tolerance * max([0.0, *a[here], *b[there]])
    pairs, single = [], []
    while here and there:
        distance = a[here[0]] - b[there[0]]
        if abs(distance) <= slack:
            pairs.append((here.pop(0), there.pop(0)))
        else:
            single.append((0, here.pop(0)) if distance < 0.0 else (1, there.pop(0)))
    return pairs, single + [(0, k) for k in here] + [(1, k) for k in there]


def _checkpoints(a: Path, b: Path, stack: ExitStack, _tolerance: float | None) -> tuple[list[Part], list[str]]:
    headers, found = [], []
    for path in (a, b):
        try:
            file = stack.enter_context(_open(path, "r"))
            header = checkpoint.read_header(file)
        except (OSError, KeyError, ValueError, TypeError) as error:
            reason = " ".join(str(error).split())
            raise JobError(f"{path}: is no checkpoint that can be read: {reason}") from None
        headers.append(header)
        found.append(_state(file, header))
    jobs = [Job.from_dict(parse_toml(header["job"], str(path)), str(path)) for header, path in zip(headers, (a, b))]
    return [Part("the checkpoints", found[0], found[1])], _job_lines(*jobs)


def _state(file: Any, header: Mapping[str, Any]) -> dict[str, Quantity]:
    """Everything a checkpoint holds: numbers of the run, fields of the cells, rates at the sides, g."""
    found = {name: Quantity(("entry",), values) for name, values in _flat_numbers(header["numbers"])}
    begin = 0
    for name, count in header["columns"]:
        found[name] = Quantity(("y", "x", "entry"), Columns(file["cells"], begin, begin + count))
        begin += count
    for name, dataset in file.get("sides", {}).items():
        found[f"sides/{name}"] = Quantity(("face", "entry"), dataset)
    found["g"] = Quantity(("y", "x", "node"), file["g"])
    return found


def _flat_numbers(numbers: Mapping[str, Any], prefix: str = "numbers/") -> Iterator[tuple[str, np.ndarray]]:
    for name, value in numbers.items():
        if isinstance(value, Mapping):
            yield from _flat_numbers(value, f"{prefix}{name}/")
        else:
            yield prefix + name, np.atleast_1d(np.array(value, dtype=np.float64))


def _job_lines(a: Job, b: Job) -> list[str]:
    differing = rundir.differing_keys(b, a)
    return [f"the jobs differ: {'; '.join(differing).replace(', was ', ' and ')}"] if differing else []


def _compare_part(part: Part, tolerance: float | None) -> tuple[bool, list[str]]:
    """Whether all quantities agree, and lines: what only one has, the first difference, the largest of each."""
    lines = [f"{part.name}: {line}" for line in [*part.notes, *_unlike(part)]]
    a, b = _comparable(part)
    size = sizes(a, b)
    found = {name: how for name in a if (how := compare(a[name], b[name], size[name], tolerance)) is not None}
    if found:
        # what differs first in the run: entries of the first axis are steps or snapshots
        ordered = part.name in (HISTORY, FIELDS)
        name = min(found, key=lambda n: found[n].first[0]) if ordered else next(iter(found))
        place, values = _place(part, name, found[name].first), found[name].values
        lines.append(f"{part.name}: first {name}{place}: {values[0]!r} and {values[1]!r}")
    for name, how in found.items():
        place = _place(part, name, how.worst)
        lines.append(f"{part.name}: largest of {name}{place}: {how.largest:.3g}, relative {how.relative:.3g}")
    return not lines, lines


def _unlike(part: Part) -> Iterator[str]:
    """What cannot be compared: quantities that only one has, or of two shapes."""
    for name in dict.fromkeys([*part.a, *part.b]):
        if name not in part.a or name not in part.b:
            yield f"{name} is in the {'first' if name in part.a else 'second'} only"
        elif part.a[name].shape != part.b[name].shape:
            yield f"{name} has shape {part.a[name].shape} and {part.b[name].shape}"


def _comparable(part: Part) -> tuple[dict[str, Quantity], dict[str, Quantity]]:
    names = [name for name in part.a if name in part.b and part.a[name].shape == part.b[name].shape]
    return {name: part.a[name] for name in names}, {name: part.b[name] for name in names}


def _place(part: Part, name: str, index: tuple[int, ...]) -> str:
    """In words, for instance " in snapshot 1 (t = 0.5), cell (3, 2), component x"."""
    axes = part.a[name].axes
    where = dict(zip(axes, index))
    words = []
    if "time" in where:
        data = part.a[name].data
        number = data.entries[index[0]] if isinstance(data, Picked) else index[0]
        words.append(f"snapshot {number} (t = {_entry(part, 'time', index[0]):g})")
    if "step" in where:
        words.append(f"step {_entry(part, 'step', index[0]):g}")
    if "x" in where and len(axes) > 1:
        words.append(f"cell ({where['x']}, {where.get('y', 0)})")
    words += [f"component {AXES[where[axis]]}" for axis in ("component", "other_component") if axis in where]
    others = ("face", "entry", "node", "xi_x")
    words += [f"{axis} {where[axis]}" for axis in others if axis in where and part.a[name].shape != (1,)]
    return f" in {', '.join(words)}" if words else ""


def _entry(part: Part, name: str, place: int) -> float:
    return float(part.a[name].read(slice(place, place + 1))[0])
