"""Two arrays, number by number: where they differ first, and by how much.

Exact means the same bits (a NaN equals a NaN in its place). With a tolerance R a difference counts where it is above R
times the size of its quantity: the largest number of it in either run, or the natural unit of what may be nought but
for rounding, such as the momentum of a gas at rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rvm_mpi import diagnostics

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
    if diagnostics.column_named(last) is not None:
        return diagnostics.natural_unit(last, beside)
    temperature = beside.get("temperature", 0.0)
    units = {
        "velocity": np.sqrt(temperature),
        "heat_flux": beside.get("density", 0.0) * temperature**1.5,
        "shear_stress": beside.get("pressure", 0.0),
    }
    return float(units.get(last, 0.0))


def sizes(a: Mapping[str, Quantity], b: Mapping[str, Quantity]) -> dict[str, float]:
    """What the differences of each quantity that both have are relative to."""
    largest = {name: max(a[name].largest(), b[name].largest()) for name in a if name in b}
    return {name: max(value, natural_unit(name, largest)) for name, value in largest.items()}
