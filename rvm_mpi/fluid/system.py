"""The macroscopic system: compressible Euler equations with granular cooling.

    d_t U + div F(U) = (0, 0, - d C rho^2 T^{3/2}),   U = (rho, rho u, E)

that is dT/dt = -2 C rho T^{3/2} in a homogeneous gas. The fluxes are those of `euler.py`; in time SSP Runge-Kutta of
third order between two halves of the cooling, which is integrated exactly.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.fluid.cells import combine, cool, largest_rate, root_mean_energy
from rvm_mpi.fluid.euler import sweep, work_size
from rvm_mpi.fluid.walls import GHOSTS, Side

if TYPE_CHECKING:
    from rvm_mpi.grid.domain import Domain
    from rvm_mpi.job.job import Job

#: a step that loses positivity is repeated as two halves at most this often
HALVINGS = 8
#: automatic rate of synchronisation over the fastest at which sound crosses a cell
SYNCHRONISED = 1 / 3


class PositivityLost(FloatingPointError):
    """Density or temperature of the fluid is not positive, whatever dt; the same on every rank.

    Attributes
    ----------
    cell : (i, j)
        Global indices of the first such cell.
    """

    def __init__(self, message: str, cell: tuple[int, int]) -> None:
        super().__init__(message)
        self.cell = cell


class FluidSystem:
    """The macroscopic system on this rank's cells.

    Parameters
    ----------
    job : Job
        Its space, velocity.dimensions and collision.cooling are used.
    domain : Domain
        Who owns which cells, and the exchange of ghosts.

    Attributes
    ----------
    state : (ny + 2 wy, nx + 2 wx, d + 2) array
        (rho, rho u, E) with three ghost layers in each active direction.
    cooling : float
        C in dT/dt = -2 C rho T^{3/2}.
    """

    def __init__(self, job: Job, domain: Domain) -> None:
        self.job, self.domain = job, domain
        self.directions = domain.dimensions
        self.velocity_dimensions = d = int(job.velocity.dimensions)
        if self.directions > d:
            raise ValueError(f"{self.directions} space dimensions need as many velocity dimensions, not {d}")
        self.cooling = float(job.collision.cooling)
        self.power = 1.0 if job.collision.exponent is None else float(job.collision.exponent)
        nx, ny = domain.local
        if min(domain.local[: self.directions], default=GHOSTS) < GHOSTS:
            raise ValueError(f"the fluid needs {GHOSTS} cells or more in each direction, not {nx} x {ny}")
        self._wx = GHOSTS if self.directions >= 1 else 0
        self._wy = GHOSTS if self.directions == 2 else 0
        self.state = np.zeros((ny + 2 * self._wy, nx + 2 * self._wx, d + 2))
        self.state[..., 0], self.state[..., -1] = 1.0, 0.5 * d
        self._interior = self.state[self._wy : self._wy + ny, self._wx : self._wx + nx]
        self._saved, self._start, self._change = (np.empty_like(self._interior) for _ in range(3))
        self._work = np.zeros(work_size(max(nx, ny)))
        names = [f"{axis}-{end}" for axis in "xy"[: self.directions] for end in ("lower", "upper")]
        self._sides = {name: Side(name, job.space.sides[name], d) for name in names if domain.on_side(name)}

    @property
    def interior(self) -> np.ndarray:
        """The state of this rank's cells, (ny, nx, d + 2), a view."""
        return self._interior

    def set_state(self, density: np.ndarray, velocity: np.ndarray, temperature: np.ndarray) -> None:
        """Set the initial state; far fields without a state of their own keep it at their side from now on.

        Parameters
        ----------
        density, temperature : (ny, nx) arrays
            Both positive.
        velocity : (ny, nx, d) array

        Raises
        ------
        ValueError
            If a density or temperature is not positive.
        """
        if not (np.all(density > 0.0) and np.all(temperature > 0.0)):
            raise ValueError("the fluid needs a positive density and temperature in every cell")
        d, inside = self.velocity_dimensions, self._interior
        speed2 = np.zeros(inside.shape[:2])
        for c in range(d):
            inside[..., 1 + c] = density * velocity[..., c]
            speed2 += velocity[..., c] ** 2
        inside[..., 0] = density
        inside[..., -1] = 0.5 * density * (d * temperature + speed2)
        for side in self._sides.values():
            side.remember(self.state)
        self.fill_ghosts()

    def fill_ghosts(self) -> None:
        """Fill the ghosts of the state: by the domain (collective), then at the physical sides."""
        if self.directions == 0:
            return
        self.domain.exchange(self.state, GHOSTS)
        for side in self._sides.values():
            side.fill(self.state)

    def advance(self, dt: float) -> None:
        """One time step; collective. Positive for max_rate() dt <= 1/2.

        The speeds may grow within a step. Should a stage lose positivity by it, all ranks repeat the step as
        two halves.

        Parameters
        ----------
        dt : float

        Raises
        ------
        PositivityLost
            On every rank, if positivity is lost whatever dt.
        """
        self._advance(dt, HALVINGS)

    def _advance(self, dt: float, halvings: int) -> None:
        self._saved[:] = self._interior
        self._cool(0.5 * dt)
        lost = self._transport(dt) if self.directions else None
        if self.domain.maximum(0.0 if lost is None else 1.0)[0] > 0.0:
            self._interior[:] = self._saved
            if halvings == 0:
                raise self._complaint(lost, dt)
            self._advance(0.5 * dt, halvings - 1)
            self._advance(0.5 * dt, halvings - 1)
            return
        self._cool(0.5 * dt)

    def _cool(self, dt: float) -> None:
        if self.cooling != 0.0:
            cool(self._interior, self.cooling, self.power, dt)

    def _transport(self, dt: float) -> tuple[int, int] | None:
        """SSP Runge-Kutta step of the fluxes; the first cell (row, column) to lose positivity, if any."""
        inside, first = self._interior, None
        self._start[:] = inside
        for weight in (1.0, 0.25, 2.0 / 3.0):
            self._fluxes(dt)
            lost = combine(inside, self._start, self._change, weight)
            if first is None and lost < inside.shape[0] * inside.shape[1]:
                first = divmod(lost, inside.shape[1])
        return first

    def _fluxes(self, dt: float) -> None:
        """Change of the state by its fluxes over dt, with its ghosts filled first."""
        self.fill_ghosts()
        for axis in range(self.directions):
            self._sweep(axis, dt)

    def _sweep(self, axis: int, dt: float) -> None:
        lower, upper = (f"{'xy'[axis]}-{end}" for end in ("lower", "upper"))
        sweep(
            self.state,
            self._change,
            axis,
            self.directions,
            dt / self.domain.spacing[axis],
            lower in self._sides and self._sides[lower].solid,
            upper in self._sides and self._sides[upper].solid,
            self._work,
        )

    def _complaint(self, lost: tuple[int, int] | None, dt: float) -> PositivityLost:
        """What to say, the same on all ranks: it names the first cell of all."""
        density, _velocity, temperature = self.moments()
        bad = np.argwhere(~((density > 0.0) & (temperature > 0.0)))
        if bad.size:  # it came in with the state
            lost = (int(bad[0, 0]), int(bad[0, 1]))
        (i0, j0), nx = self.domain.start, self.domain.cells[0]
        mine = -math.inf if lost is None else -float((lost[0] + j0) * nx + lost[1] + i0)
        j, i = divmod(int(-self.domain.maximum(mine)[0]), nx)
        what = f"the fluid lost positive density or temperature at any step down to {dt:.3g}"
        return PositivityLost(f"{what} in {self.domain.place((i, j))}", (i, j))

    def max_rate(self) -> float:
        """Largest sum over directions of (|u_n| + c)/h, here and just outside; collective: fills ghosts."""
        self.fill_ghosts()
        dx, dy = self.domain.spacing
        return float(
            largest_rate(
                self.state,
                self._wy,
                self._wx,
                1.0 / dy if self.directions == 2 else 0.0,
                1.0 / dx if self.directions >= 1 else 0.0,
            )
        )

    def moments(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Density (ny, nx), velocity (ny, nx, d) and temperature (ny, nx) of this rank's cells, copies."""
        inside, d = self._interior, self.velocity_dimensions
        density = inside[..., 0].copy()
        velocity = inside[..., 1:-1] / density[..., None]
        momentum2 = np.zeros_like(density)
        for c in range(d):
            momentum2 += inside[..., 1 + c] ** 2
        return density, velocity, 2.0 * (inside[..., -1] - 0.5 * momentum2 / density) / (d * density)

    def omega(self, out: np.ndarray | None = None) -> np.ndarray:
        """The scaling omega = sqrt(2E/(d rho)).

        Parameters
        ----------
        out : (ny + 2 wy, nx + 2 wx) array, optional
            Filled in place: this rank's cells, or with up to three ghost layers in the active directions.
            With ghosts the call is collective; those of the corners are of no use, but finite.

        Returns
        -------
        array
            `out`, or a new (ny, nx) array.
        """
        ny, nx = self._interior.shape[:2]
        if out is None:
            out = np.empty((ny, nx))
        ghosts_y, ghosts_x = (out.shape[0] - ny) // 2, (out.shape[1] - nx) // 2
        if ghosts_y or ghosts_x:
            self.fill_ghosts()
        y, x = self._wy - ghosts_y, self._wx - ghosts_x
        if min(y, x) < 0 or out.shape != (ny + 2 * ghosts_y, nx + 2 * ghosts_x):
            raise ValueError(f"omega of {ny} x {nx} cells does not fill an array of shape {out.shape}")
        root_mean_energy(self.state[y : y + out.shape[0], x : x + out.shape[1]], out)
        return out

    def synchronise(self, kinetic: np.ndarray, temperature: np.ndarray, dt: float) -> None:
        """Draw the state towards the kinetic moments at the rate that the job's `scaling.synchronise` says; collective.

        The automatic rate is a third of the fastest at which sound of f's temperature crosses a cell. What Euler lacks
        parts the two by a gradient's width over the speed of sound, and a gradient is some cells wide: a much slower
        rate lets them part, a much faster one ties omega to the moments that it scales. One rate for all cells: what
        reaches the cold ones comes from the hot ones.

        Parameters
        ----------
        kinetic : (ny, nx, d + 2) array
            (rho, rho u, E) of this rank's cells.
        temperature : (ny, nx) array
            Of the same.
        dt : float
            The time.
        """
        rate = self.job.scaling.synchronise
        if rate == "auto":
            d = self.velocity_dimensions
            hottest = self.domain.maximum(float(temperature.max()))[0]
            sound = math.sqrt((d + 2) / d * hottest)
            rate = SYNCHRONISED * sound / min(self.domain.spacing[: self.directions])
        self.relax_towards(kinetic, rate, dt)

    def relax_towards(self, kinetic: np.ndarray, rate: float, dt: float) -> None:
        """Draw the state towards the kinetic moments: U += (1 - exp(-rate dt)) (U_kinetic - U).

        Parameters
        ----------
        kinetic : (ny, nx, d + 2) array
            (rho, rho u, E) of this rank's cells.
        rate, dt : float
            In units of 1/time, and the time.
        """
        self._interior += -math.expm1(-rate * dt) * (kinetic - self._interior)
