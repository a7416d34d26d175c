"""Ghost cells of g and omega: from the neighbours, then what lies beyond the physical sides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi.kinetic.walls import KINDS, Side, fill_side
from rvm_mpi.kinetic.walls_thermal import fill_moving_side

if TYPE_CHECKING:
    from rvm_mpi.grid.domain import Domain
    from rvm_mpi.job.job import Job
    from rvm_mpi.step.data import Cells, Grid, Model, Sides, Space

#: ghost cells of g: a face's value reaches two cells
GHOSTS = 2
SIDES = ("x-lower", "x-upper", "y-lower", "y-upper")


def mirrors(boundary: Any) -> bool:
    """Whether a side is a wall that mirrors all that arrives."""
    return bool(boundary.kind == "specular" or (boundary.kind == "maxwell" and boundary.accommodation == 0.0))


class GhostCells:
    """Fills the ghost cells of a rank.

    Parameters
    ----------
    job : Job
    domain : Domain
    initial : tuple of arrays
        Density (ny, nx), velocity (ny, nx, d) and temperature tensor (ny, nx, d, d) of f at the start: what a far field
        has that is given no state of its own.
    grid, space, model : data.Grid, data.Space, data.Model
    """

    def __init__(
        self, job: Job, domain: Domain, initial: tuple[np.ndarray, ...], grid: Grid, space: Space, model: Model
    ) -> None:
        self.job, self.domain, self.grid, self.space, self.model = job, domain, grid, space, model
        #: rho, u, T of the wall or the far gas along each physical side of this rank
        self.states = {name: self._side_states(name, *initial) for name in SIDES if domain.on_side(name)}
        self._work = np.zeros((6, grid.nodes.shape[1]))

    def _side_states(self, name: str, density: np.ndarray, velocity: np.ndarray, tensor: np.ndarray) -> np.ndarray:
        """What the job says of a side, else the initial state there."""
        d = self.grid.dimensions
        place = 0 if name.endswith("lower") else -1
        edge: Any = np.s_[:, place] if name[0] == "x" else np.s_[place, :]
        boundary = self.job.space.sides[name]
        states = np.zeros((density[edge].size, 5))
        states[:, 0] = density[edge]
        states[:, 1 : 1 + d] = velocity[edge]
        states[:, 4] = np.trace(tensor[edge], axis1=-2, axis2=-1) / d
        if boundary.density is not None:
            states[:, 0] = boundary.density
        if boundary.velocity is not None:
            states[:, 1 : 1 + d] = boundary.velocity
        if boundary.temperature is not None:
            states[:, 4] = boundary.temperature
        return states

    def fill(self, g: np.ndarray, cells: Cells, sides: Sides) -> None:
        """Fill them, and note in `sides.beyond` what no ghost cell can say; collective."""
        self.domain.exchange(g, GHOSTS)
        self.domain.exchange(cells.omega[..., None], GHOSTS)
        if self.model.thermal:
            self.domain.exchange(cells.mean, GHOSTS)
            for name, states in self.states.items():
                self._fill_moving(g, cells, name, states)
            return
        for name, states in self.states.items():
            axis, lower = "xy".index(name[0]), name.endswith("lower")
            side = self._side(name)
            omega = self._fill_omega(cells.omega, axis, lower, mirrored=side.kind == KINDS["specular"])
            last = 0 if lower else -1
            sums = np.ascontiguousarray(cells.sums[:, last] if axis == 0 else cells.sums[last])
            beyond = sides.of(SIDES.index(name))[1]
            fill_side(g.reshape(-1), side, states, omega, sums, self.grid, self._work, beyond)

    def _fill_moving(self, g: np.ndarray, cells: Cells, name: str, states: np.ndarray) -> None:
        """Ghost cells beyond a side in the thermal scaling, and their frames."""
        axis, lower = "xy".index(name[0]), name.endswith("lower")
        space, side = self.space, self._side(name)
        along = np.s_[space.wy : space.wy + space.ny] if axis == 0 else np.s_[space.wx : space.wx + space.nx]
        omega, mean = (np.moveaxis(field, 1 - axis, 0)[:, along] for field in (cells.omega, cells.mean))
        near, far, edge, next_one = (1, 0, 2, 3) if lower else (-2, -1, -3, -4)
        inner = np.concatenate([mean[edge], omega[edge][:, None]], axis=-1)
        frames = np.empty_like(inner)
        fill_moving_side(g.reshape(-1), side, states, inner, frames, self.grid, self._work)
        mean[near], omega[near] = frames[:, :3], frames[:, 3]
        mean[far], omega[far] = mean[near], omega[near]
        if side.kind == KINDS["specular"]:
            mean[far], omega[far] = mean[next_one], omega[next_one]
            mean[far, :, axis] *= -1.0

    def _fill_omega(self, field: np.ndarray, axis: int, lower: bool, mirrored: bool) -> np.ndarray:
        """Fill omega beyond a side, so that on the face it is that of the inner cell; returns the inner cells'.

        A specular wall mirrors it like the gas. Else, where faces see omega upwind, the near cell is such that
        differences are as 1 to -1/2 for what leaves and as 4 to 1 for what enters: `limiter.face_number` then gives the
        inner cell's.
        """
        space = self.space
        inner = np.s_[space.wy : space.wy + space.ny], np.s_[space.wx : space.wx + space.nx]
        field = field[inner[0]].T if axis == 0 else field[:, inner[1]]
        near, far, edge, next_one = (1, 0, 2, 3) if lower else (-2, -1, -3, -4)
        omega = field[edge].copy()
        if mirrored or not self.model.conservative:
            field[near], field[far] = omega, field[next_one] if mirrored else omega
        else:
            half = 0.5 * (field[next_one] - omega)
            field[near], field[far] = omega + half, omega + 5.0 * half
        return omega

    def _side(self, name: str) -> Side:
        space, block = self.space, self.grid.block
        axis, lower = "xy".index(name[0]), name.endswith("lower")
        row = block * (space.nx + 2 * space.wx)
        first = space.wy * row + space.wx * block
        boundary = self.job.space.sides[name]
        kind, accommodation = "specular" if mirrors(boundary) else boundary.kind, boundary.accommodation
        return Side(
            inner=first if lower else first + ((space.nx - 1) * block if axis == 0 else (space.ny - 1) * row),
            along=(row, block)[axis],
            inward=(block, row)[axis] * (1 if lower else -1),
            axis=axis,
            sign=1 if lower else -1,
            kind=KINDS[kind],
            accommodation=1.0 if accommodation is None else float(accommodation),
            rate=(space.per_dx, space.per_dy)[axis] if self.model.carried else 0.0,
        )
