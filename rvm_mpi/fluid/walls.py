"""Ghost cells of the fluid at the physical sides of the domain.

Every function works on a view of the state whose first axis is the distance from outside inwards: its first
`GHOSTS` layers are ghosts, the next ones the cells behind the side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rvm_mpi.compiling.declare import kernel

if TYPE_CHECKING:
    from rvm_mpi.job.job import Boundary

#: ghost layers of the fluid's state: the reach of WENO5
GHOSTS = 3
#: density of the ghosts of a vacuum relative to the cell behind the side
VACUUM = 1e-10


@kernel
def mirror(
    state: np.ndarray, normal: int, accommodation: float, temperature: float, velocity: np.ndarray
) -> None:
    """Maxwell wall: what the cells mirror, a fraction of it thermalised; specular with accommodation 0.

    The thermalised part has the mirrored density and normal velocity, the wall's tangential velocity and
    temperature: E = d rho T_w/2 + rho |u|^2/2.

    Parameters
    ----------
    state : (layers, cells, d + 2) array, any strides
        Ghost layers are overwritten.
    normal : int
        0 for a side in x, 1 in y.
    accommodation, temperature : float
        Thermalised fraction in [0, 1] and the wall's temperature.
    velocity : (d,) array
        The wall's velocity; its normal component is not used.
    """
    layers, cells, components = state.shape
    d = components - 2
    for ghost in range(GHOSTS):
        inner = min(2 * GHOSTS - 1 - ghost, layers - 1 - GHOSTS)
        for i in range(cells):
            density = state[inner, i, 0]
            kinetic = 0.0
            state[ghost, i, 0] = density
            for c in range(d):
                momentum = state[inner, i, 1 + c]
                if c == normal:
                    wall = -momentum
                    mirrored = -momentum
                else:
                    wall = density * velocity[c]
                    mirrored = momentum
                kinetic += wall * wall
                state[ghost, i, 1 + c] = (1.0 - accommodation) * mirrored + accommodation * wall
            wall = 0.5 * (d * density * temperature + kinetic / density)
            state[ghost, i, d + 1] = (1.0 - accommodation) * state[inner, i, d + 1] + accommodation * wall


@kernel
def extend(state: np.ndarray, factor: float) -> None:
    """Ghosts repeat the cell behind the side, times a factor: 1 for outflow, tiny for a vacuum.

    Parameters
    ----------
    state : (layers, cells, d + 2) array, any strides
        Ghost layers are overwritten.
    factor : float
        Density, momentum and energy of the ghosts relative to the cell's; velocity and temperature stay.
    """
    _layers, cells, components = state.shape
    for ghost in range(GHOSTS):
        for i in range(cells):
            for c in range(components):
                state[ghost, i, c] = factor * state[GHOSTS, i, c]


class Side:
    """One physical side of this rank's block: fills its ghosts.

    Parameters
    ----------
    name : str
        "x-lower", "x-upper", "y-lower" or "y-upper".
    boundary : Boundary
        The job's boundary there.
    dimensions : int
        Velocity dimensions d.

    Attributes
    ----------
    axis : int
        0 for a side in x, 1 in y.
    accommodation, temperature : float
        Of a wall: the thermalised fraction and its temperature.
    velocity : (d,) array
        Of a wall.
    given : (d + 2,) array or None
        The state beyond the side, where the job gives one.
    start : (cells, d + 2) array or None
        The initial state behind it.

    Raises
    ------
    ValueError
        For a kind of boundary that is not in `KINDS`.
    """

    def __init__(self, name: str, boundary: Boundary, dimensions: int) -> None:
        if boundary.kind not in KINDS:
            raise ValueError(f"the fluid knows no boundary of kind {boundary.kind!r}")
        self.axis, self.upper = "xy".index(name[0]), name.endswith("upper")
        self._kind = KINDS[boundary.kind]
        self.accommodation = 1.0 if boundary.accommodation is None else boundary.accommodation
        self.temperature = 0.0 if boundary.temperature is None else boundary.temperature
        self.velocity = np.zeros(dimensions)
        if boundary.velocity is not None:
            self.velocity[:] = boundary.velocity
        self.given: np.ndarray | None = None
        self.start: np.ndarray | None = None
        if boundary.density is not None:
            density = boundary.density
            energy = 0.5 * density * (dimensions * self.temperature + self.velocity @ self.velocity)
            self.given = np.array([density, *(density * self.velocity), energy])

    @property
    def solid(self) -> bool:
        """Whether no mass crosses it."""
        return self._kind.solid

    def remember(self, state: np.ndarray) -> None:
        """Keep the initial state behind the side: a far field that was given none has it.

        Parameters
        ----------
        state : (ny + 2 wy, nx + 2 wx, d + 2) array
            Ghosted initial state.
        """
        self.start = self._inwards(state)[GHOSTS].copy()

    def fill(self, state: np.ndarray) -> None:
        """Fill this side's ghosts of a ghosted state (ny + 2 wy, nx + 2 wx, d + 2)."""
        self._kind.fill(self._inwards(state), self)

    def _inwards(self, state: np.ndarray) -> Any:
        view = state if self.axis == 1 else state.transpose(1, 0, 2)
        return view[::-1] if self.upper else view


# --- the kinds of boundary: each fills the ghosts of a view (layers, cells, d + 2) as its side says


def specular(view: np.ndarray, side: Side) -> None:
    """A wall that mirrors."""
    mirror(view, side.axis, 0.0, side.temperature, side.velocity)


def maxwell(view: np.ndarray, side: Side) -> None:
    """A wall that mirrors and thermalises."""
    mirror(view, side.axis, side.accommodation, side.temperature, side.velocity)


def far_field(view: np.ndarray, side: Side) -> None:
    """Gas of a given state, else of the initial one."""
    outside = side.start if side.given is None else side.given
    if outside is None:
        raise ValueError("a far field without a state of its own needs set_state first")
    view[:GHOSTS] = outside


def outflow(view: np.ndarray, side: Side) -> None:
    """The gas behind the side goes on beyond it."""
    extend(view, 1.0)


def vacuum(view: np.ndarray, side: Side) -> None:
    """Hardly any gas."""
    extend(view, VACUUM)


class Kind(NamedTuple):
    """A kind of boundary."""

    fill: Callable[[np.ndarray, Side], None]
    solid: bool = False
    """Whether no mass crosses it."""


KINDS = {
    "specular": Kind(specular, solid=True),
    "maxwell": Kind(maxwell, solid=True),
    "far-field": Kind(far_field),
    "outflow": Kind(outflow),
    "vacuum": Kind(vacuum),
}
"""The fluid's boundary conditions by the job's name for them: a new one is a function and a line here."""
