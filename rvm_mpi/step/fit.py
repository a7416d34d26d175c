"""Whether a state can start on the velocity grid: one rule, for `rvm check` ahead of a run and for the run's own start.

A state of f is written in g's velocities, xi = v/omega. The grid holds its Gaussian where no positive function on the
nodes would need more variance than it has, along each direction by itself (`kinetic/realisable.realisable_tensor`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, sqrt
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.kinetic.realisable import ROOM
from rvm_mpi.states import distribution

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

#: what rounding may take of that room, so that a kernel's fused arithmetic comes to the same answer
ROUNDING = 1e-12
#: largest relative error of the moments that a sampled initial state may be corrected by
SAMPLED = 0.1
#: states whose Gaussians are tried together
AT_ONCE = 64
DIAGONAL = (0, 3, 5)


@dataclass(frozen=True)
class Scaled:
    """A state in g's velocities, cell by cell.

    Attributes
    ----------
    omega : (ny, nx) array
        sqrt(T + |u|^2/d), the scaling of a cell at the start, sqrt(T) where velocities are counted from the mean; one
        where nothing is rescaled.
    mean : (ny, nx, 3) array
        Mean of xi; zero in directions not in use.
    tensor : (ny, nx, 6) array
        Covariance of xi: xx, xy, xz, yy, yz, zz.
    """

    omega: np.ndarray
    mean: np.ndarray
    tensor: np.ndarray


def scaled(job: Job, velocity: np.ndarray, tensor: np.ndarray, unit: float = 1.0) -> Scaled:
    """A state of f, velocity (ny, nx, d) and temperature tensor (ny, nx, d, d), in g's velocities.

    unit: omega where nothing is rescaled, the speed that xi is then measured in (`units.py`).
    """
    d = job.velocity.dimensions
    cells = velocity.shape[:2]
    thermal = job.scaling.kind == "thermal"
    energy = np.trace(tensor, axis1=-2, axis2=-1) + (0.0 if thermal else np.sum(velocity**2, axis=-1))
    omega = np.sqrt(energy / d) if job.scaling.kind != "none" else np.full(cells, unit)
    mean, packed = np.zeros((*cells, 3)), np.zeros((*cells, 6))
    if not thermal:
        mean[..., :d] = velocity / omega[..., None]
    for place, (a, b) in enumerate([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]):
        if b < d:
            packed[..., place] = tensor[..., a, b] / omega**2
    return Scaled(omega, mean, packed)


def nodes_of(points: int, half_width: float) -> np.ndarray:
    """(points,) nodes of one direction, as `velocity.VelocityGrid` has them."""
    return (2 * np.arange(points) + 1 - points) * (0.5 * (2 * half_width / points))


def least_variance(points: int, half_width: float, mean: np.ndarray) -> np.ndarray:
    """The least variance of a Gaussian with this mean on the nodes of one direction; infinite beyond the last node.

    With all weight on the two nodes around the mean it is their distances' product, and above that `ROOM` h^2.
    """
    nodes = nodes_of(points, half_width)
    h = nodes[1] - nodes[0]
    below = np.clip(((mean - nodes[0]) / h).astype(int), 0, points - 2)
    least = (mean - nodes[below]) * (nodes[below + 1] - mean) + (ROOM + ROUNDING) * h * h
    return np.where(np.abs(mean) < nodes[-1], least, np.inf)


def holds_anywhere(spacing: float) -> float:
    """Variance from which nodes this far apart hold a Gaussian whatever its mean; half-way is hardest."""
    return (0.25 + ROOM + ROUNDING) * spacing**2


def points_for(job: Job, variance: float) -> list[int] | None:
    """Points that hold this variance along each direction whatever the mean; None where they would be too many."""
    if not variance > 0.0:
        return None
    widest = sqrt(variance / (0.25 + 2 * ROOM))
    axes = zip(job.velocity.points, job.velocity.half_width, strict=True)
    found = [max(points, ceil(2 * width / widest)) for points, width in axes]
    return found if max(found) <= 1024 else None


def misfit(
    job: Job, density: np.ndarray, velocity: np.ndarray, tensor: np.ndarray, start: tuple[int, int] = (0, 0)
) -> str:
    """Why a state cannot start on the job's velocity grid, in one line; empty where it can.

    Parameters
    ----------
    job : Job
    density, velocity, tensor : arrays (ny, nx), (ny, nx, d), (ny, nx, d, d)
        Of f, on a block of cells.
    start : tuple of int
        Global indices (i, j) of the block's first cell.
    """
    temperature = np.trace(tensor, axis1=-2, axis2=-1)
    finite = np.isfinite(density) & np.isfinite(velocity).all(-1) & np.isfinite(tensor).all((-2, -1))
    sick = ~(finite & (density > 0.0) & (temperature > 0.0))
    if sick.any():
        return f"the initial state has no positive, finite density and temperature in {_cell(sick, start)}"
    with np.errstate(over="ignore", under="ignore", invalid="ignore", divide="ignore"):
        state = scaled(job, velocity, tensor)
    if not (np.isfinite(state.mean).all() and np.isfinite(state.tensor).all() and (state.omega > 0.0).all()):
        return "the initial state's speeds are too large or too small for double precision"
    return _too_cold(job, state, start) or _no_gaussian(job, state, start) or _badly_sampled(job, density, state)


def _cell(where: np.ndarray, start: tuple[int, int]) -> str:
    j, i = (int(k) for k in np.unravel_index(int(np.argmax(where)), where.shape))
    return f"cell ({i + start[0]}, {j + start[1]})"


def _too_cold(job: Job, state: Scaled, start: tuple[int, int]) -> str:
    axes = list(zip(job.velocity.points, job.velocity.half_width, strict=True))
    for axis, (points, width) in enumerate(axes):
        least = least_variance(points, width, state.mean[..., axis])
        short = least - state.tensor[..., DIAGONAL[axis]]
        if not (short > 0.0).any():
            continue
        at = np.unravel_index(int(np.argmax(short)), short.shape)
        enough = points_for(job, float(state.tensor[..., DIAGONAL[: len(axes)]].min()))
        of = "T" if job.scaling.kind == "none" else "T_g"
        return (
            f"velocity.points: too few for the initial state (value {list(job.velocity.points)}"
            + (f"; allowed such as {enough}" if enough else "")
            + f"): in {_cell(short == short[at], start)} they hold no {of} below {least[at]:.4g} along {'xyz'[axis]} "
            f"at its mean velocity, it needs {state.tensor[at][DIAGONAL[axis]]:.4g}"
        )
    return ""


def _no_gaussian(job: Job, state: Scaled, start: tuple[int, int]) -> str:
    """Where the Gaussian is not a product of one for each direction, or stands at the box's edge: try it."""
    doubtful = (state.tensor[..., [1, 2, 4]] != 0.0).any(-1)
    for axis, (points, width) in enumerate(zip(job.velocity.points, job.velocity.half_width, strict=True)):
        doubtful |= np.abs(state.mean[..., axis]) > nodes_of(points, width)[-2]
    if not doubtful.any():
        return ""
    from rvm_mpi.step.initial import failing

    places = np.argwhere(doubtful)
    every = np.concatenate([state.mean[doubtful], state.tensor[doubtful]], axis=-1)
    different, first = np.unique(every, axis=0, return_index=True)
    for n in range(0, len(different), AT_ONCE):
        part = different[n : n + AT_ONCE]
        failed = failing(job, part[:, :3], part[:, 3:])
        if failed.any():
            j, i = places[first[n : n + AT_ONCE][failed].min()]
            return (
                "velocity: the initial state does not fit the velocity grid (points "
                f"{list(job.velocity.points)}, half width {list(job.velocity.half_width)}): no Gaussian on its nodes "
                f"has the mean and temperature of cell ({i + start[0]}, {j + start[1]}); take more points or another "
                "half_width"
            )
    return ""


def _badly_sampled(job: Job, density: np.ndarray, state: Scaled) -> str:
    """A state that is no Gaussian is sampled at the nodes: how far off its moments are before they are corrected."""
    if distribution(job) is None:
        return ""
    from rvm_mpi.step.initial import Sampler

    sampler = Sampler(job)
    for j, i in np.ndindex(density.shape):
        _, off = sampler.block(density[j, i], state.omega[j, i], state.mean[j, i], state.tensor[j, i])
        if not 0.0 <= off < SAMPLED:
            return (
                "velocity: the initial state does not fit the velocity grid (points "
                f"{list(job.velocity.points)}, half width {list(job.velocity.half_width)}): sampled at its nodes, the "
                f"moments are wrong by more than {SAMPLED:g} of their size; take more points or another half_width"
            )
    return ""
