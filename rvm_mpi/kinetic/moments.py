"""f's moments from g and omega: density, velocity, stress, temperature, heat flux, and marginals of g."""

from __future__ import annotations

from typing import Any

import numpy as np

from rvm_mpi.compiling.declare import kernel
from rvm_mpi.kinetic.conservation import SUMS, Correction, weighted_sums


@kernel
def _sums_about(g, space, grid, centres, work, result):  # type: ignore[no-untyped-def]
    row = (space.nx + 2 * space.wx) * grid.block
    for j in range(space.ny):
        for i in range(space.nx):
            cell = (j + space.wy) * row + (i + space.wx) * grid.block
            weighted_sums(g[cell : cell + grid.block], centres[j, i], grid, work, result[j, i])


def sums_about(g: np.ndarray, space: Any, grid: Any, centres: np.ndarray) -> np.ndarray:
    """Sums over the nodes of each cell, about its centre (ny, nx, 3), in the order of `conservation.SUMS`.

    Parameters
    ----------
    g : ghosted blocks (ny + 2 wy, nx + 2 wx, block)

    Returns
    -------
    (ny, nx, 14) array
    """
    result = np.empty((space.ny, space.nx, SUMS))
    _sums_about(g.reshape(-1), space, grid, centres, Correction.ones(grid), result)
    return result


def tensor_from_sums(sums: np.ndarray, d: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Density (without the node weight), mean and central second moments from sums (..., 10).

    Returns
    -------
    density (...), mean (..., d), tensor (..., d, d)
    """
    density = sums[..., 0]
    mean = sums[..., 1 : 1 + d] / density[..., None]
    second = np.empty((*density.shape, 3, 3))
    for place, (a, b) in enumerate([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]):
        second[..., a, b] = second[..., b, a] = sums[..., 4 + place]
    tensor = second[..., :d, :d] / density[..., None, None] - mean[..., :, None] * mean[..., None, :]
    return density, mean, tensor


def fields(
    g: np.ndarray, frames: tuple[np.ndarray, np.ndarray], sums: np.ndarray, space: Any, grid: Any
) -> dict[str, np.ndarray]:
    """Density, velocity, temperature, stress tensors and heat flux of f on the cells of a rank.

    Parameters
    ----------
    g : ghosted blocks (ny + 2 wy, nx + 2 wx, block)
    frames : tuple of (ny, nx) array, (ny, nx, 3) array
        omega, and the velocity that xi is counted from.
    sums : (ny, nx, 10) array
        Sums of g over the nodes (`data.Cells`).

    Returns
    -------
    dict
        density (ny, nx), velocity (ny, nx, d), temperature (ny, nx), stress (ny, nx, d, d), a temperature tensor,
        pressure_tensor (ny, nx, d, d) = int c c^T f dv = density x stress, and heat_flux (ny, nx, d) =
        1/2 int c |c|^2 f dv; c = v - velocity.
    """
    d, (omega, counted_from) = grid.dimensions, frames
    density, mean, tensor = tensor_from_sums(sums, d)
    third = sums_about(g, space, grid, sums[..., 1:4] / density[..., None])[..., 10:13]
    w = omega[..., None]
    stress = w[..., None] ** 2 * tensor
    return {
        "density": density * grid.weight,
        "velocity": counted_from[..., :d] + w * mean,
        "temperature": omega**2 * np.trace(tensor, axis1=-2, axis2=-1) / d,
        "stress": stress,
        "pressure_tensor": (density * grid.weight)[..., None, None] * stress,
        "heat_flux": 0.5 * (w * w * w) * grid.weight * third[..., :d],
    }
