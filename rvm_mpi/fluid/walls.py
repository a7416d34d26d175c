"""Ghost cells of the fluid at the physical sides of the domain.

Every function works on a view of the state whose first axis is the distance from outside inwards: its first
`GHOSTS` layers are ghosts, the next ones the cells behind the side.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi.compiling.declare import kernel

if TYPE_CHECKING:
    from rvm_mpi.job.job import Boundary

#: ghost layers of the fluid's state: the reach of WENO5
GHOSTS = 3
#: density of the ghosts of a vacuum relative to the cell behind the side
VACUUM = 1e-10
#: kinds of side that no mass crosses
SOLID = ("specular", "maxwell")


@kernel(fused=False)
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


@kernel(fused=False)
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
    """

    def __init__(self, name: str, boundary: Boundary, dimensions: int) -> None:
        self.axis, self.upper = "xy".index(name[0]), name.endswith("upper")
        self.kind = boundary.kind
        self.solid = self.kind in SOLID
        self.accommodation = self.temperature = 0.0
        self.velocity = np.zeros(dimensions)
        #: far-field state, (d + 2,) or one per cell along the side
        self.outside: np.ndarray | None = None
        if boundary.velocity is not None:
            self.velocity[:] = boundary.velocity
        if boundary.temperature is not None:
            self.temperature = boundary.temperature
        if self.kind == "maxwell":
            self.accommodation = 1.0 if boundary.accommodation is None else boundary.accommodation
        elif self.kind == "far-field" and boundary.density is not None:
            density = boundary.density
            energy = 0.5 * density * (dimensions * self.temperature + self.velocity @ self.velocity)
            self.outside = np.array([density, *(density * self.velocity), energy])
        elif self.kind not in ("specular", "far-field", "outflow", "vacuum"):
            raise ValueError(f"the fluid knows no boundary of kind {self.kind!r}")

    def remember(self, state: np.ndarray) -> None:
        """Store the initial state at a far field that was given none.

        Parameters
        ----------
        state : (ny + 2 wy, nx + 2 wx, d + 2) array
            Ghosted initial state.
        """
        if self.kind == "far-field" and (self.outside is None or self.outside.ndim == 2):
            self.outside = self._inwards(state)[GHOSTS].copy()

    def fill(self, state: np.ndarray) -> None:
        """Fill this side's ghosts of a ghosted state (ny + 2 wy, nx + 2 wx, d + 2)."""
        view = self._inwards(state)
        if self.kind == "far-field":
            if self.outside is None:
                raise ValueError("a far field without a state of its own needs set_state first")
            view[:GHOSTS] = self.outside
        elif self.solid:
            mirror(view, self.axis, self.accommodation, self.temperature, self.velocity)
        else:
            extend(view, VACUUM if self.kind == "vacuum" else 1.0)

    def _inwards(self, state: np.ndarray) -> Any:
        view = state if self.axis == 1 else state.transpose(1, 0, 2)
        return view[::-1] if self.upper else view
