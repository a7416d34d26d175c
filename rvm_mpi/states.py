"""Initial states by name, evaluated cell by cell from global positions.

Whatever a state needs that is not exactly rounded arithmetic (cosines, random numbers) is computed along
whole rows and columns of the grid and then cut, so that a cell's value does not depend on the block it is
asked in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi.job.initial import Bkw, TwoGaussians
from rvm_mpi.job.text import JobError
from rvm_mpi.units import power

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

Fields = tuple[np.ndarray, np.ndarray, np.ndarray]
SMALLEST_WAVE = 1e-10
"""Amplitude, against the longest wave's, at which a smooth random field's Fourier series is cut."""


@dataclass(frozen=True)
class Block:
    """Cells i0 <= i < i1, j0 <= j < j1 of a job's grid, numbered globally."""

    job: Job
    i0: int
    i1: int
    j0: int
    j1: int

    @property
    def shape(self) -> tuple[int, int]:
        """(ny, nx) of the block."""
        return self.j1 - self.j0, self.i1 - self.i0

    @property
    def dimensions(self) -> int:
        """Number of velocity dimensions."""
        return self.job.velocity.dimensions

    def fraction(self, axis: int) -> np.ndarray:
        """(n,) centres of all cells of the domain along x (0) or y (1), as fractions of its length."""
        cells = (*self.job.space.cells, 1, 1)[axis]
        return (np.arange(cells) + 0.5) / cells

    def centres(self, axis: int) -> np.ndarray:
        """(n,) cell centres of the block along x (0) or y (1); zero along a direction space does not have."""
        space = self.job.space
        first, last = ((self.i0, self.i1), (self.j0, self.j1))[axis]
        if axis >= space.dimensions:
            return np.zeros(last - first)
        return space.lower[axis] + (np.arange(first, last) + 0.5) * space.spacing[axis]

    def cut(self, values: np.ndarray) -> np.ndarray:
        """The block's part of an array (ny, nx, ...) on the whole domain."""
        return values[self.j0 : self.j1, self.i0 : self.i1]

    def fields(self, density: Any, velocity: Any, temperature: Any) -> Fields:
        """Density, velocity and temperature tensor filled into the shapes of the block."""
        d = self.dimensions
        stress = np.zeros((*self.shape, d, d))
        diagonal = np.arange(d)
        stress[..., diagonal, diagonal] = np.broadcast_to(temperature, self.shape)[..., None]
        return (
            np.array(np.broadcast_to(density, self.shape), dtype=float),
            np.array(np.broadcast_to(velocity, (*self.shape, d)), dtype=float),
            stress,
        )


def macroscopic_state(job: Job, i0: int, i1: int, j0: int, j1: int) -> Fields:
    """Density, velocity and temperature tensor of f at the start, on a block of cells.

    Parameters
    ----------
    job : Job
        Names the state and the grid.
    i0, i1, j0, j1 : int
        Global index ranges of the block in x and y; 0, 1 along a direction that space does not have.

    Returns
    -------
    density : (ny, nx) array
    velocity : (ny, nx, d) array
    stress : (ny, nx, d, d) array
        The temperature tensor Theta, temperature times the identity unless the state is anisotropic.

    Raises
    ------
    JobError
        If a run to start from does not fit this job's grid.
    """
    return STATES[job.initial.state](job.initial, Block(job, i0, i1, j0, j1))


def uniform(state: Any, block: Block) -> Fields:
    """The same everywhere; a stress tensor makes it an anisotropic Gaussian."""
    density, velocity, stress = block.fields(state.density, state.velocity, state.temperature)
    if state.stress is not None:
        stress[...] = state.stress
    return density, velocity, stress


def random_density(state: Any, block: Block) -> Fields:
    """Density uniformly distributed over (low, high), without or with correlation between cells.

    White noise: the numbers of row j are those of a Philox generator keyed by (seed, j). Smooth: the Fourier
    series of `smooth_noise`, normally distributed, through the normal distribution function.
    """
    if state.correlation_length > 0:
        from scipy.special import ndtr

        uniform_numbers = ndtr(smooth_noise(state.seed, state.correlation_length, block))
    else:
        rows = [_philox(state.seed, j, block.i1)[block.i0 :] for j in range(block.j0, block.j1)]
        uniform_numbers = np.array(rows).reshape(block.shape)
    density = state.low + (state.high - state.low) * uniform_numbers
    return block.fields(density, 0.0, state.temperature)


def _philox(seed: int, stream: int, count: int) -> np.ndarray:
    """The first random numbers of a stream, uniform on the open interval (0, 1), the same everywhere."""
    raw = np.random.Philox(key=np.array([seed, stream], dtype=np.uint64)).random_raw(count)
    # 52 bits: half an odd number of 2^-52 is exact, and never 0 or 1
    return ((raw >> np.uint64(12)).astype(float) + 0.5) * 2.0**-52


def smooth_noise(seed: int, length: float, block: Block) -> np.ndarray:
    """A periodic Gaussian random field of mean 0 and variance 1, the same on every grid.

    It is the Fourier series sum over m != 0 of sqrt(S(k)) (a_m cos + b_m sin)(k . (x - lower)), with
    k = 2 pi m / (length of the domain) and S ~ exp(-(k length)^2 / 2), that is the correlation
    exp(-r^2 / (2 length^2)) in a large domain. The normal numbers a_m, b_m of mode m = (m_x, m_y) depend on
    seed and m alone, so neither the grid nor the number of waves kept changes them.

    Parameters
    ----------
    seed : int
    length : float
        Correlation length, in units of space.
    block : Block

    Returns
    -------
    (ny, nx) array
    """
    waves = [2 * np.pi * length / extent for extent in block.job.space.length]
    last = [_last_wave(wave) for wave in waves] + [0]
    amplitudes = _amplitudes(seed, waves, last[0], last[1])
    cos_x, sin_x = _waves(block.fraction(0), last[0])
    cos_y, sin_y = _waves(block.fraction(1), last[1])
    across, along = slice(block.i0, block.i1), slice(block.j0, block.j1)
    field = np.zeros(block.shape)
    even, odd = np.zeros((2, last[0] + 1, block.shape[0]))
    for m_y in range(-last[1], last[1] + 1):
        a, b = amplitudes[:, m_y + last[1], :, None].swapaxes(0, 1)
        cosine, sine = cos_y[abs(m_y), along], np.sign(m_y) * sin_y[abs(m_y), along]
        even += a * cosine + b * sine
        odd += b * cosine - a * sine
    for m_x in range(last[0] + 1):
        field += even[m_x, :, None] * cos_x[m_x, across] + odd[m_x, :, None] * sin_x[m_x, across]
    return field


def _last_wave(wave: float) -> int:
    """Number of the shortest wave kept along a direction, at least one."""
    return max(1, int(np.ceil(np.sqrt(1.0 - 4 * np.log(SMALLEST_WAVE) / wave**2))))


def _waves(fraction: np.ndarray, last: int) -> tuple[np.ndarray, np.ndarray]:
    """(last + 1, n) cosines and sines of the waves 0..last at these fractions of the domain's length."""
    phase = 2 * np.pi * np.outer(np.arange(last + 1), fraction)
    return np.cos(phase), np.sin(phase)


def _amplitudes(seed: int, waves: list[float], last_x: int, last_y: int) -> np.ndarray:
    """(last_x + 1, 2 last_y + 1, 2) coefficients a, b of the modes; of m and -m only one is there."""
    from scipy.special import ndtri

    m_x = np.arange(last_x + 1)[:, None]
    m_y = np.arange(-last_y, last_y + 1)[None, :]
    exponent = (waves[0] * m_x) ** 2 + ((waves[1] * m_y) ** 2 if last_y else 0.0)
    there = (m_x > 0) | (m_y > 0)
    spectrum = np.where(there, np.exp(-0.5 * (exponent - exponent[there].min())), 0.0)
    spectrum /= np.sum(spectrum)
    normal = np.empty((last_x + 1, 2 * last_y + 1, 2))
    order = np.where(m_y > 0, 2 * m_y - 1, -2 * m_y)[0]  # a stream runs through m_y = 0, 1, -1, 2, -2, ...
    for row in range(last_x + 1):
        stream = ndtri(_philox(seed, 2**32 + row, 2 * (2 * last_y + 1))).reshape(-1, 2)
        normal[row] = stream[order]
    return np.sqrt(spectrum)[..., None] * normal


def temperature_disc(state: Any, block: Block) -> Fields:
    """Temperature `inner` where |x - centre| <= radius, `outer` elsewhere.

    A centre on the circle to round-off counts as inside, so that the disc keeps the grid's symmetries.
    """
    squares = [(block.centres(axis) - at) ** 2 for axis, at in enumerate(state.centre)]
    distance = squares[0][None, :] + (squares[1][:, None] if len(squares) > 1 else 0.0)
    inside = distance <= state.radius * state.radius * (1 + 1e-12)
    return block.fields(state.density, 0.0, np.where(inside, state.inner, state.outer))


def riemann(state: Any, block: Block) -> Fields:
    """The state `left` where the coordinate is below `position`, `right` elsewhere."""
    axis = "xy".index(state.direction)
    left = block.centres(axis) < state.position
    left = left[None, :] if axis == 0 else left[:, None]

    def pick(name: str) -> np.ndarray:
        return np.where(left, getattr(state.left, name), getattr(state.right, name))

    velocity = np.where(left[..., None], state.left.velocity, state.right.velocity)
    return block.fields(pick("density"), velocity, pick("temperature"))


def wave(state: Any, block: Block) -> Fields:
    """Each field is base + amplitude cos(2 pi mode . (x - lower)/length)."""
    mode = (*state.mode, 0.0)[:2]
    phases = [2 * np.pi * m * block.fraction(axis) for axis, m in enumerate(mode)]
    x, y = phases[0][block.i0 : block.i1], phases[1][block.j0 : block.j1]
    shape = np.cos(y)[:, None] * np.cos(x) - np.sin(y)[:, None] * np.sin(x)
    return block.fields(
        state.density + state.density_amplitude * shape,
        np.asarray(state.velocity) + np.asarray(state.velocity_amplitude) * shape[..., None],
        state.temperature + state.temperature_amplitude * shape,
    )


def from_run(state: Any, block: Block) -> Fields:
    """The kinetic fields of a snapshot of another run: mass, momentum and energy averaged over each cell."""
    density, velocity, temperature = _snapshot(state, block.job)
    return block.fields(block.cut(density), block.cut(velocity), block.cut(temperature))


def _snapshot(state: Any, job: Job) -> Fields:
    """Density (ny, nx), velocity (ny, nx, d), temperature (ny, nx) of a run on this job's whole grid."""
    from rvm_mpi.job.check_initial import check_source
    from rvm_mpi.output.read import open_run

    where = f'initial.run "{state.run}"'
    check_source(job, job.name)
    try:
        run = open_run(state.run)
    except (OSError, KeyError, ValueError) as error:
        raise JobError(f"{where}: cannot be read: {error}") from None
    density = run["kinetic_density"].values
    velocity = run["kinetic_velocity"].values
    temperature = run["kinetic_temperature"].values
    index = _which_time(state.time, run["time"].values, where)
    n = density.ndim - 1
    d = velocity.shape[-1]
    if n > job.space.dimensions or d != job.velocity.dimensions:
        raise JobError(
            f"{where}: does not fit this job: it has {n} space and {d} velocity dimensions, "
            f"the job {job.space.dimensions} and {job.velocity.dimensions}"
        )
    shape = (*(1,) * (2 - n), *density.shape[1:])
    rho, u, t = (a[index].reshape(shape + a.shape[n + 1 :]) for a in (density, velocity, temperature))
    coordinates = [run[axis].values for axis in "xy"[:n]]
    if _same_grid(coordinates, job):
        return rho, u, t
    energy = rho * (d * t + (u**2).sum(-1)) / 2
    state_there = np.concatenate([rho[..., None], rho[..., None] * u, energy[..., None]], axis=-1)
    for axis in range(2):
        cells = (*job.space.cells, 1, 1)[axis]
        if axis < n:
            weights = _overlaps(coordinates[axis], axis, job, where)
        else:
            weights = np.ones((cells, 1))
        state_there = np.moveaxis(np.tensordot(weights, state_there, (1, 1 - axis)), 0, 1 - axis)
    rho = state_there[..., 0]
    u = state_there[..., 1:-1] / rho[..., None]
    return rho, u, (2 * state_there[..., -1] / rho - (u**2).sum(-1)) / d


def _which_time(time: float | None, times: np.ndarray, where: str) -> int:
    """Index of a snapshot's time, the last by default; a time must be there to nine digits."""
    if len(times) == 0:
        raise JobError(f"{where}: holds no snapshot")
    if time is None:
        return len(times) - 1
    index = int(np.argmin(np.abs(times - time)))
    if abs(times[index] - time) > 1e-9 * max(abs(time), abs(times[index])):
        there = ", ".join(repr(float(t)) for t in times[:20]) + (", ..." if len(times) > 20 else "")
        raise JobError(f"{where}: no snapshot at initial.time (value {time}; allowed {there})")
    return index


def _same_grid(coordinates: list[np.ndarray], job: Job) -> bool:
    block = Block(job, 0, (*job.space.cells, 1)[0], 0, (*job.space.cells, 1, 1)[1])
    return len(coordinates) == job.space.dimensions and all(
        len(there) == job.space.cells[axis]
        and np.allclose(there, block.centres(axis), rtol=0, atol=1e-9 * job.space.spacing[axis])
        for axis, there in enumerate(coordinates)
    )


def _overlaps(centres: np.ndarray, axis: int, job: Job, where: str) -> np.ndarray:
    """(cells here, cells there) shares of the cells of a run in each cell of this job along a direction."""
    there = (centres[-1] - centres[0]) / (len(centres) - 1)
    edges_there = centres[0] + (np.arange(len(centres) + 1) - 0.5) * there
    low, here = job.space.lower[axis], job.space.spacing[axis]
    edges_here = low + np.arange(job.space.cells[axis] + 1) * here
    slack = 1e-9 * (edges_there[-1] - edges_there[0])
    if edges_here[0] < edges_there[0] - slack or edges_here[-1] > edges_there[-1] + slack:
        raise JobError(
            f"{where}: covers {_ends(edges_there)} along {'xy'[axis]}, "
            f"this job's domain is {_ends(edges_here)}"
        )
    start = np.maximum(edges_here[:-1, None], edges_there[None, :-1])
    stop = np.minimum(edges_here[1:, None], edges_there[None, 1:])
    share = np.maximum(stop - start, 0.0)
    return share / share.sum(axis=1, keepdims=True)


def _ends(edges: np.ndarray) -> str:
    least = 1e-9 * float(edges[-1] - edges[0])
    low, high = (f"{edge if abs(edge) > least else 0.0:.9g}" for edge in edges[[0, -1]].tolist())
    return f"{low} to {high}"


def two_gaussians(state: Any, block: Block) -> Fields:
    """Moments of two Gaussians of variance sigma^2 at +-sigma (1, .., 1): Theta = sigma^2 (I + ones)."""
    density, velocity, stress = block.fields(1.0, 0.0, 0.0)
    stress[...] = state.sigma * state.sigma * (np.eye(block.dimensions) + np.ones((block.dimensions,) * 2))
    return density, velocity, stress


def bkw(state: Any, block: Block) -> Fields:
    """Moments of the exact solution for Maxwell molecules: unit density and temperature, at rest."""
    return block.fields(1.0, 0.0, 1.0)


def distribution(job: Job) -> Callable[..., np.ndarray] | None:
    """f at the start as a function of velocity, where it is no Gaussian: takes an array for each direction.

    The moments are those of `macroscopic_state`, density one.
    """
    d, state = job.velocity.dimensions, job.initial
    if isinstance(state, TwoGaussians):
        sigma = state.sigma
        volume = power(2 * np.pi * (sigma * sigma), d / 2)

        def two(*v: np.ndarray) -> np.ndarray:
            return 0.5 * sum(
                np.exp(-0.5 * sum(((c + sign * sigma) / sigma) ** 2 for c in v)) / volume for sign in (-1.0, 1.0)
            )

        return two
    if isinstance(state, Bkw):
        return lambda *v: bkw_solution(d, d / (d + 2), sum(c * c for c in v))
    return None


def bkw_solution(d: int, spread: float, square: np.ndarray) -> np.ndarray:
    """The solution of Bobylev, Krook and Wu for elastic Maxwell molecules, at |v|^2 = square.

    f = (2 pi K)^(-d/2) exp(-|v|^2/(2 K)) (1 + (1 - K)/K (|v|^2/(2 K) - d/2)), density and temperature one, at rest.
    1 - K decays as exp(-b |S^(d-1)| (d - 1) t/(4 d eps)) from 2/(d + 2) or less, where f(0) = 0, at time 0.
    """
    reduced = square / (2 * spread)
    return (
        (2 * np.pi * spread) ** (-d / 2) * np.exp(-reduced) * (1 + (1 - spread) / spread * (reduced - d / 2))
    )


STATES: dict[str, Callable[[Any, Block], Fields]] = {
    "uniform": uniform,
    "random-density": random_density,
    "temperature-disc": temperature_disc,
    "riemann": riemann,
    "wave": wave,
    "from-run": from_run,
    "two-gaussians": two_gaussians,
    "bkw": bkw,
}
