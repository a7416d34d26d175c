"""A stand-in for `rvm_mpi.grid.domain.Domain` without MPI or PETSc: one block, or several in threads."""

import threading
from types import SimpleNamespace

import numpy as np


def make_job(cells, lower, upper, sides="periodic", d=3, cooling=0.0):
    """The attributes of a Job that the fluid uses; `sides`: a kind for all, or name -> kind or keys."""
    active = [f"{axis}-{end}" for axis in "xy"[: len(cells)] for end in ("lower", "upper")]
    sides = dict.fromkeys(active, sides) if isinstance(sides, str) else sides
    full = {}
    for name in active:
        keys = {"kind": sides[name]} if isinstance(sides[name], str) else sides[name]
        defaults = {"accommodation": None, "temperature": None, "density": None, "velocity": None}
        full[name] = SimpleNamespace(**{**defaults, **keys})
    spacing = tuple((b - a) / n for a, b, n in zip(lower, upper, cells, strict=True))
    space = SimpleNamespace(
        cells=tuple(cells),
        lower=tuple(lower),
        upper=tuple(upper),
        dimensions=len(cells),
        spacing=spacing,
        sides=full,
    )
    return SimpleNamespace(
        space=space, velocity=SimpleNamespace(dimensions=d), collision=SimpleNamespace(cooling=cooling, exponent=None)
    )


class SerialDomain:
    """All cells in one block."""

    comm = None
    rank, size = 0, 1

    def __init__(self, job):
        self.job = job
        self.dimensions = job.space.dimensions
        self.cells = (*job.space.cells, 1, 1)[:2]
        self.spacing = (*job.space.spacing, 1.0, 1.0)[:2]
        self.start, self.local = (0, 0), self.cells

    def on_side(self, name):
        sides = self.job.space.sides
        return name in sides and sides[name].kind != "periodic"

    def exchange(self, array, width):
        w = width
        if self.dimensions >= 1 and not self.on_side("x-lower"):
            array[:, :w], array[:, -w:] = array[:, -2 * w : -w].copy(), array[:, w : 2 * w].copy()
        if self.dimensions == 2 and not self.on_side("y-lower"):
            array[:w], array[-w:] = array[-2 * w : -w].copy(), array[w : 2 * w].copy()

    def maximum(self, *values):
        return [float(v) for v in values]

    def place(self, cell):
        return f"cell ({cell[0]}, {cell[1]})"


class Blocks:
    """What the blocks of one decomposition share."""

    def __init__(self, px, py):
        self.px, self.py = px, py
        self.barrier = threading.Barrier(px * py, timeout=60)
        self.arrays, self.values = [None] * (px * py), [None] * (px * py)


class BlockDomain(SerialDomain):
    """One of px x py blocks; each is stepped by its own thread."""

    def __init__(self, job, blocks, rank):
        super().__init__(job)
        self.blocks, self.rank, self.size = blocks, rank, blocks.px * blocks.py
        self.column, self.row = rank % blocks.px, rank // blocks.px
        nx, ny = self.cells
        x = [nx * k // blocks.px for k in range(blocks.px + 1)]
        y = [ny * k // blocks.py for k in range(blocks.py + 1)]
        self.start = (x[self.column], y[self.row])
        self.local = (x[self.column + 1] - x[self.column], y[self.row + 1] - y[self.row])

    def on_side(self, name):
        if not super().on_side(name):
            return False
        position, count = (self.column, self.blocks.px) if name[0] == "x" else (self.row, self.blocks.py)
        return position == (0 if name.endswith("lower") else count - 1)

    def exchange(self, array, width):
        b, w = self.blocks, width
        wx, wy = (w if self.dimensions >= 1 else 0), (w if self.dimensions == 2 else 0)
        b.arrays[self.rank] = array
        b.barrier.wait()
        received = []
        lower, upper = (-1, slice(0, w), slice(-2 * w, -w)), (1, slice(-w, None), slice(w, 2 * w))
        for step, mine, theirs in (lower, upper):
            if self.dimensions >= 1 and not self.on_side("x-lower" if step < 0 else "x-upper"):
                other = b.arrays[self.row * b.px + (self.column + step) % b.px]
                rows = slice(wy, array.shape[0] - wy)
                received.append(((rows, mine), other[rows, theirs].copy()))
            if self.dimensions == 2 and not self.on_side("y-lower" if step < 0 else "y-upper"):
                other = b.arrays[(self.row + step) % b.py * b.px + self.column]
                columns = slice(wx, array.shape[1] - wx)
                received.append(((mine, columns), other[theirs, columns].copy()))
        b.barrier.wait()
        for where, values in received:
            array[where] = values
        b.barrier.wait()

    def maximum(self, *values):
        b = self.blocks
        b.values[self.rank] = values
        b.barrier.wait()
        result = np.max(np.array(b.values), axis=0)
        b.barrier.wait()
        return [float(v) for v in result]
