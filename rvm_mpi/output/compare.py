"""Two runs, or two checkpoints, number by number, in words: what differs first, and by how much."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from rvm_mpi.job.job import Job, JobError
from rvm_mpi.job.text import parse_toml
from rvm_mpi.output import restart, rundir
from rvm_mpi.output.differences import Columns, Picked, Quantity, compare, sizes
from rvm_mpi.output.hdf5 import datasets, open_alone
from rvm_mpi.output.history import HISTORY
from rvm_mpi.output.layout import AXES, FIELDS
from rvm_mpi.output.read import read_history


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
    one, other = (stack.enter_context(open_alone(path / FIELDS, "r")) for path in (a, b))
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
        for name, dataset in [("time", file["time"]), *datasets(file)]:
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
            file = stack.enter_context(open_alone(path, "r"))
            header = restart.read_header(file)
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
