"""f's moments from g and omega: density, velocity, stress, temperature, heat flux, and marginals of g."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from rvm_mpi.kinetic.conservation import weighted_sums
from rvm_mpi.simd import KERNEL


@njit(**KERNEL)
def _central_third(g, space, grid, sums, powers, ones_x, ones_slab, result):  # type: ignore[no-untyped-def]
    """Sums of c |c|^2, c = xi - mean, over the nodes of each cell: result (ny, nx, 3)."""
    out = np.zeros(14)
    centre = np.zeros(3)
    row = (space.nx + 2 * space.wx) * grid.block
    for j in range(space.ny):
        for i in range(space.nx):
            cell = (j + space.wy) * row + (i + space.wx) * grid.block
            for q in range(3):
                centre[q] = sums[j, i, 1 + q] / sums[j, i, 0]
            block = g[cell : cell + grid.block]
            weighted_sums(
                block,
                centre,
                grid.points[0],
                grid.slab_size,
                grid.x,
                grid.slab,
                ones_x,
                ones_slab,
                powers,
                out,
            )
            for q in range(3):
                result[j, i, q] = out[10 + q]


@njit(**KERNEL)
def all_sums(g, space, grid, powers, ones_x, ones_slab, result):  # type: ignore[no-untyped-def]
    """Sums of 1, xi, xi xi over the nodes of each cell: result (ny, nx, 10)."""
    out = np.zeros(14)
    centre = np.zeros(3)
    row = (space.nx + 2 * space.wx) * grid.block
    for j in range(space.ny):
        for i in range(space.nx):
            cell = (j + space.wy) * row + (i + space.wx) * grid.block
            block = g[cell : cell + grid.block]
            weighted_sums(
                block,
                centre,
                grid.points[0],
                grid.slab_size,
                grid.x,
                grid.slab,
                ones_x,
                ones_slab,
                powers,
                out,
            )
            for q in range(10):
                result[j, i, q] = out[q]


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
    g: np.ndarray, omega: np.ndarray, sums: np.ndarray, space: Any, grid: Any
) -> dict[str, np.ndarray]:
    """Density, velocity, temperature, stress tensor and heat flux of f on the cells of a rank.

    Parameters
    ----------
    g : ghosted blocks (ny + 2 wy, nx + 2 wx, block)
    omega : (ny, nx) array
    sums : (ny, nx, 10) array
        Sums of g over the nodes (`stage.Cells`).

    Returns
    -------
    dict
        density (ny, nx), velocity (ny, nx, d), temperature (ny, nx), stress (ny, nx, d, d), a temperature tensor, and
        heat_flux (ny, nx, d) = 1/2 int c |c|^2 f dv.
    """
    d = grid.dimensions
    density, mean, tensor = tensor_from_sums(sums, d)
    third = np.empty((*density.shape, 3))
    powers, ones_x, ones_slab = np.zeros(5 * grid.points[0]), np.ones(grid.points[0]), np.ones(grid.slab_size)
    _central_third(g.reshape(-1), space, grid, sums, powers, ones_x, ones_slab, third)
    w = omega[..., None]
    return {
        "density": density * grid.weight,
        "velocity": w * mean,
        "temperature": omega**2 * np.trace(tensor, axis1=-2, axis2=-1) / d,
        "stress": w[..., None] ** 2 * tensor,
        "heat_flux": 0.5 * w**3 * grid.weight * third[..., :d],
    }
