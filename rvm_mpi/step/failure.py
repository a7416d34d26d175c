"""What stops a step: the cell and the velocity where it failed, said in one line that is the same on every rank."""

from __future__ import annotations

import math
from typing import Any, NoReturn

import numpy as np

from rvm_mpi.step.data import NO_CORRECTION, NO_GAUSSIAN, NOT_A_NUMBER, NOT_POSITIVE, TOO_COLD_FOR_GRID

PROBLEMS = {
    TOO_COLD_FOR_GRID: "the velocity grid cannot hold the temperature: T_g is below what its spacing resolves",
    NO_GAUSSIAN: "no Gaussian on the velocity grid has the moments wanted",
    NO_CORRECTION: "g could not be corrected to its mass, momentum and energy",
    NOT_POSITIVE: "density or temperature is not positive",
    NOT_A_NUMBER: "g is not a number",
}


class NumericalFailure(RuntimeError):
    """The run cannot go on: what happened and where, in one line; the same on every rank.

    Attributes
    ----------
    cell : (i, j) or None
        Global indices of the cell, where there is one to name.
    node : tuple of int or None
        Indices of its first velocity that is no number.
    dt : float
        Length of the step that failed.
    """

    def __init__(
        self,
        message: str,
        cell: tuple[int, int] | None = None,
        node: tuple[int, ...] | None = None,
        dt: float = math.nan,
    ) -> None:
        super().__init__(message)
        self.cell, self.node, self.dt = cell, node, dt


def fail(stepper: Any, worst: int) -> NoReturn:
    """Name the first bad cell of a `KineticStepper`'s last stage; every rank raises, the line is the same on all.

    What is no number spreads to the neighbours within the stage: the cell to name is the one that had it before.
    """
    domain = stepper.domain
    cell = first_cell(domain, np.argwhere(~np.isfinite(stepper.inside(stepper.last.g)).all(axis=-1)))
    if cell is not None:
        worst = NOT_A_NUMBER
    else:
        cell = first_cell(domain, np.argwhere(stepper.report["status"] == worst))
        cell = cell or first_cell(domain, np.argwhere(~np.isfinite(stepper.cell_rates().at(1.0))))
    node = _sick_node(stepper, cell) if cell is not None and worst == NOT_A_NUMBER else None
    where = "" if cell is None else f" in {domain.place(cell)}"
    if node is not None:
        where += f", velocity node ({', '.join(map(str, node))})"
    raise NumericalFailure(PROBLEMS[worst] + where, cell, node)


def first_cell(domain: Any, places: np.ndarray) -> tuple[int, int] | None:
    """The first (i, j) in the order of all cells of cells (j, i) that ranks have found; collective."""
    (i0, j0), nx = domain.start, domain.cells[0]
    mine = -min(((int(j) + j0) * nx + int(i) + i0 for j, i in places), default=math.inf)
    first = -domain.maximum(float(mine))[0]
    if not math.isfinite(first):
        return None
    j, i = divmod(int(first), nx)
    return i, j


def _sick_node(stepper: Any, cell: tuple[int, int]) -> tuple[int, ...] | None:
    """Indices of the first velocity of a cell that is no number, before or after the stage; collective."""
    domain, grid = stepper.domain, stepper.grid
    (i0, j0), (nx, ny) = domain.start, domain.local
    i, j = cell[0] - i0, cell[1] - j0
    found = -math.inf
    if 0 <= i < nx and 0 <= j < ny:
        for g in (stepper.last.g, stepper.last.out):
            sick = np.flatnonzero(~np.isfinite(stepper.velocity_grid.unpack(stepper.inside(g)[j, i])))
            if sick.size:
                found = float(sick[0])
                break
    found = domain.maximum(found)[0]
    if not math.isfinite(found):
        return None
    return tuple(int(k) for k in np.unravel_index(int(found), grid.points))[: grid.dimensions]
