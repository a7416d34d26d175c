"""Space: which rank owns which cells, and how ghost cells travel.

The decomposition, the neighbours and periodicity are those of a PETSc DMDA. Only strips of ghost cells are
sent, with mpi4py and straight from the arrays, so that a message of g never counts more than one side's ghosts and
no index has to number the unknowns of the whole phase space.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi.grid import placement
from rvm_mpi.job.job import JobError

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

_Strip = tuple[slice, slice]

#: a rank needs this many cells in a direction that is split: the widest stencil (WENO5) reaches three cells
FEWEST_CELLS = 3
#: in a cell's work: the fluxes of a ghost cell with the strips of both its sides, and what more a border between ranks
#: costs than one within a rank; strips along x cost what those along y do (docs/scaling.md)
SIDE, BORDER = 1.0, 0.5


def start_petsc() -> Any:
    """PETSc, started if nobody has: without its signal handlers, which end a program where a pipe's reader leaves."""
    import petsc4py

    if "petsc4py.PETSc" not in sys.modules:
        petsc4py.init(["rvm", "-no_signal_handler"])
    from petsc4py import PETSc

    return PETSc


def largest_ranks(cells: tuple[int, ...]) -> int:
    """The largest number of ranks that can share `cells` (0 to 2 directions)."""
    count = 1
    for n in cells:
        count *= max(1, n // FEWEST_CELLS)
    return count


def partition(cells: tuple[int, ...], ranks: int) -> tuple[int, int]:
    """Ranks along x and y: the split with the least work for the rank that has most.

    Work is counted in cells: a rank's own, `SIDE` for each along one side in x and one in y, and `BORDER` for each
    along a border with another rank. Of equals the one with the fewest ranks along x: rows alone take fewer messages.

    Parameters
    ----------
    cells : tuple of int
        Cells in each direction; () is the space-homogeneous problem.
    ranks : int
        Number of MPI ranks.

    Returns
    -------
    tuple of int
        Ranks along x, ranks along y.

    Raises
    ------
    JobError
        If no split leaves every rank at least three cells in each direction that is split.
    """
    nx, ny = (*cells, 1, 1)[:2]

    def work(split: tuple[int, int]) -> tuple[float, int]:
        px, py = split
        wide, high = -(-nx // px), -(-ny // py)
        border = (high if px > 1 else 0) + (wide if py > 1 else 0)
        return wide * high + SIDE * (wide + high) + BORDER * border, px

    found = list(_splits(nx, ny, ranks))
    if found:
        return min(found, key=work)
    largest = largest_ranks(cells)
    most = next(n for n in range(min(ranks - 1, largest), 0, -1) if any(_splits(nx, ny, n)))
    shape = " x ".join(map(str, cells)) if cells else "one cell (no space dimension)"
    raise JobError(
        f"{ranks} ranks cannot share {shape}: each needs at least {FEWEST_CELLS} cells in each direction that is "
        f"split; the largest possible number below is {most}"
        + (f", the largest of all {largest}" if largest != most else "")
    )


def _splits(nx: int, ny: int, ranks: int) -> Iterator[tuple[int, int]]:
    """Ranks along x and y in every way that leaves each enough cells in each direction that is split."""
    for px in range(1, min(ranks, max(1, nx // FEWEST_CELLS)) + 1):
        py = ranks // px
        if px * py == ranks and (py == 1 or ny // py >= FEWEST_CELLS):
            yield px, py


def _placed(comm: Any, split: tuple[int, int], cells: tuple[int, int]) -> Any:
    """The same ranks, numbered so that those of a node are neighbours; collective."""
    if comm.Get_size() == 1:
        return comm
    numbers = placement.places(split, cells, placement.nodes(comm))
    return comm if numbers == sorted(numbers) else comm.Split(0, numbers[comm.Get_rank()])


@dataclass(frozen=True)
class _Neighbour:
    """One side across which ghost cells travel: axis 0 is y, 1 is x; end 0 the lower, 1 the upper."""

    axis: int
    end: int
    rank: int

    def opposite(self) -> _Neighbour:
        return _Neighbour(self.axis, 1 - self.end, self.rank)


class Domain:
    """The cells of this rank and its neighbours.

    Attributes
    ----------
    comm : mpi4py.MPI.Comm
        The communicator, its ranks numbered along x first (`placement.py`); rank and size are its.
    cells : tuple of int
        (nx, ny) of the whole domain, 1 in an unused direction.
    dimensions : int
        Space dimensions, 0 to 2.
    spacing : tuple of float
        (dx, dy), 1 in an unused direction.
    start, local : tuple of int
        First global cell (i0, j0) and number of cells (nx, ny) of this rank.
    """

    def __init__(self, job: Job, comm: Any = None) -> None:
        from mpi4py import MPI

        PETSc = start_petsc()
        given = MPI.COMM_WORLD if comm is None else comm
        self.size, self._launched = given.Get_size(), given.Get_rank()
        cells = tuple(job.space.cells)
        self.dimensions = len(cells)
        nx, ny = (*cells, 1, 1)[:2]
        self.cells = (nx, ny)
        dx, dy = (*job.space.spacing, 1.0, 1.0)[:2]
        self.spacing = (dx, dy)
        self._lower = tuple(job.space.lower)
        px, py = partition(cells, self.size)
        self.comm = _placed(given, (px, py), (-(-nx // px), -(-ny // py)))
        self.rank = self.comm.Get_rank()
        self._sides = dict(job.space.sides)
        periodic = [self._sides[f"{axis}-lower"].kind == "periodic" for axis in "xy"[: self.dimensions]]
        periodic += [False] * (2 - len(periodic))
        self._da = PETSc.DMDA().create(
            dim=2,
            dof=1,
            sizes=(nx, ny),
            proc_sizes=(px, py),
            boundary_type=tuple("periodic" if p else "ghosted" for p in periodic),
            stencil_type="star",
            stencil_width=1,
            comm=self.comm,
        )
        (i0, i1), (j0, j1) = self._da.getRanges()
        self.start, self.local = (i0, j0), (i1 - i0, j1 - j0)
        self._periodic = tuple(periodic)
        self._neighbours = self._find_neighbours(px, py)
        self._datatypes: dict[tuple[Any, ...], Any] = {}

    def _find_neighbours(self, px: int, py: int) -> list[_Neighbour]:
        """DMDA numbers its ranks along x first."""
        column, row = self.rank % px, self.rank // px
        found = []
        for axis, position, count in ((1, column, px), (0, row, py)):
            periodic = self._periodic[1 - axis]
            if axis == 0 and self.dimensions < 2 or self.dimensions < 1:
                continue
            for end, step in ((0, -1), (1, 1)):
                other = position + step
                if periodic:
                    other %= count
                if 0 <= other < count:
                    rank = row * px + other if axis == 1 else other * px + column
                    found.append(_Neighbour(axis, end, rank))
        return found

    def on_side(self, name: str) -> bool:
        """Whether this rank touches the physical (not periodic) side "x-lower", "x-upper", "y-lower" or "y-upper"."""
        if name not in self._sides or self._sides[name].kind == "periodic":
            return False
        axis, end = "xy".index(name[0]), name[2:]
        first, count = self.start[axis], self.local[axis]
        return first == 0 if end == "lower" else first + count == self.cells[axis]

    def ghosts(self, width: int) -> tuple[int, int]:
        """Ghost cells (wy, wx) on each side of an array of the given ghost width: none in an unused direction."""
        return (width if self.dimensions == 2 else 0), (width if self.dimensions >= 1 else 0)

    def owner(self, cell: tuple[int, int]) -> int:
        """The rank, as launched, that has the global cell (i, j); collective."""
        mine = all(first <= k < first + n for k, first, n in zip(cell, self.start, self.local))
        return int(self.maximum(float(self._launched if mine else -1))[0])

    def centre(self, cell: tuple[int, int]) -> tuple[float, ...]:
        """Position of the centre of the global cell (i, j), one number per space dimension."""
        along = zip(cell, self._lower, self.spacing)
        return tuple(low + (k + 0.5) * h for k, low, h in along)

    def place(self, cell: tuple[int, int]) -> str:
        """A global cell in words: indices, position, rank; collective."""
        words, owner = f"cell ({cell[0]}, {cell[1]})", self.owner(cell)
        if self.dimensions:
            words += f" at ({', '.join(f'{x:.4g}' for x in self.centre(cell))})"
        return words + (f" of rank {owner}" if self.size > 1 else "")

    def empty(self, width: int, components: int, guard: int = 0) -> np.ndarray:
        """A ghosted field (ny + 2 wy, nx + 2 wx, components) of zeros, with the guard of `aligned`."""
        wy, wx = self.ghosts(width)
        shape = (self.local[1] + 2 * wy, self.local[0] + 2 * wx, components)
        return aligned(shape, guard)

    def exchange(self, array: np.ndarray, width: int) -> None:
        """Fill the ghost strips of a ghosted field from the neighbours, periodic ones included; corners are left.

        Parameters
        ----------
        array : (ny + 2 wy, nx + 2 wx, m) array of float
            Changed in its ghost cells only; physical sides are untouched.
        width : int
            Its ghost width.
        """
        if not array.flags.c_contiguous:
            raise ValueError("a ghosted field must be contiguous")
        requests = []
        for neighbour in self._neighbours:
            inside, outside = self._strips(neighbour, array.shape, width)
            if neighbour.rank == self.rank:
                array[outside] = array[self._strips(neighbour.opposite(), array.shape, width)[0]]
                continue
            # a strip sent across my lower end arrives across the neighbour's upper end
            tag = 4 * neighbour.axis + neighbour.end
            back = 4 * neighbour.axis + 1 - neighbour.end
            receive, send = self._datatype(array.shape, outside), self._datatype(array.shape, inside)
            requests.append(self.comm.Irecv([array, 1, receive], source=neighbour.rank, tag=back))
            requests.append(self.comm.Isend([array, 1, send], dest=neighbour.rank, tag=tag))
        if requests:
            from mpi4py import MPI

            MPI.Request.Waitall(requests)

    def _strips(self, neighbour: _Neighbour, shape: tuple[int, ...], width: int) -> tuple[_Strip, _Strip]:
        """The strip of own cells that goes to a neighbour, and the ghosts that come from it."""
        wy, wx = self.ghosts(width)
        nx, ny = self.local
        w, n = (wx, nx) if neighbour.axis == 1 else (wy, ny)
        own = slice(w, 2 * w) if neighbour.end == 0 else slice(n, n + w)
        ghost = slice(0, w) if neighbour.end == 0 else slice(n + w, n + 2 * w)
        if neighbour.axis == 1:
            across = slice(wy, wy + ny)
            return (across, own), (across, ghost)
        across = slice(wx, wx + nx)
        return (own, across), (ghost, across)

    def _datatype(self, shape: tuple[int, ...], strip: _Strip) -> Any:
        """An MPI type that sends a strip straight from the array: counted in cells, no copy, no 32-bit overflow."""
        from mpi4py import MPI

        key = (shape, strip[0].start, strip[0].stop, strip[1].start, strip[1].stop)
        if key not in self._datatypes:
            block = MPI.DOUBLE.Create_contiguous(int(np.prod(shape[2:])))
            counts = [part.stop - part.start for part in strip]
            starts = [part.start for part in strip]
            self._datatypes[key] = block.Create_subarray(list(shape[:2]), counts, starts).Commit()
        return self._datatypes[key]

    def maximum(self, *values: float) -> list[float]:
        """The largest over all ranks of each value."""
        if self.size == 1:
            return [float(v) for v in values]
        from mpi4py import MPI

        mine, result = np.array(values, dtype=float), np.empty(len(values))
        self.comm.Allreduce(mine, result, op=MPI.MAX)
        return [float(v) for v in result]

    def total(self, *counts: float) -> list[float]:
        """The sum over all ranks of each value; of whole numbers, for which the order does not matter."""
        if self.size == 1:
            return [float(v) for v in counts]
        mine, result = np.array(counts, dtype=float), np.empty(len(counts))
        self.comm.Allreduce(mine, result)
        return [float(v) for v in result]


def aligned(shape: tuple[int, ...], guard: int = 0) -> np.ndarray:
    """Zeros of `shape` whose first element lies on a 64-byte border.

    With a guard, that many zeros stand before and behind: a kernel may read beyond a block where what it reads
    is then multiplied by zero.
    """
    count = int(np.prod(shape))
    # numpy asks for huge pages (fewer addresses for the processor to look up) for arrays that it does not clear itself
    raw = np.empty(count + 2 * guard + 16)
    raw[:] = 0.0
    first = guard + (-(raw.ctypes.data // 8 + guard)) % 8
    return raw[first : first + count].reshape(shape)
