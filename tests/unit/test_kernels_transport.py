"""Fluxes through the faces between cells, and their moments, against plain NumPy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy_twins import SHAPES, laid_out, make_grid, nodes, random_g, signed, upwinded

from rvm_mpi.kinetic.transport import PIECE, UpperFaces, upper_fluxes
from rvm_mpi.step.data import kernel_grid

SETTINGS = settings(max_examples=40, deadline=None)
OMEGA = st.floats(1e-3, 10.0)
PAIR = st.tuples(OMEGA, OMEGA)
WIDTH = st.floats(1e-2, 1e3)
CASES = {
    "points": st.sampled_from([*SHAPES, (4, 18, 16), (3, 20, 15)]),
    "seed": st.integers(0, 2**32 - 1),
    "both_signs": st.booleans(),
    "omega": PAIR,
    "per_dx": WIDTH,
}


def flux_twin(grid, cells, axis, omega, per_width):
    """Flux through the face between the second and the third cell; omega for velocities that go up and down."""
    xi = nodes(grid)[axis] * np.ones(grid.points)
    return signed(*omega, xi) * per_width * xi * upwinded(*cells, xi)


def assert_moments(moments, grid, flux, axis, omega):
    """Sums of the flux times 1, omega xi, omega^2 |xi|^2, to round-off of what was added up; the twin's without any."""
    w = signed(*omega, nodes(grid)[axis])
    xi = np.broadcast_arrays(*nodes(grid))
    weights = [1.0, *(w * along for along in xi), w**2 * sum(along**2 for along in xi)]
    wanted = [math.fsum((flux * weight).flat) for weight in weights]
    size = np.abs(flux).sum() * np.array([1.0, 7, 7, 7, 150]) * max(omega) ** np.array([0, 1, 1, 1, 2])
    assert np.all(np.abs(moments - wanted) <= 1e-15 * size)


def run_upper(grid, cells, rng, omegas, per_dx, per_dy, west, south, two):
    """cells (ny, nx, ..) with nx = 4; the cell is the second of its row, in 2D the second row of four."""
    kernel = kernel_grid(grid)
    flat, at = laid_out(grid, cells, rng)
    row = 4 * grid.block
    cell = at + grid.block + (row if two else 0)
    change, mx, my = np.empty(grid.block), np.empty(5), np.empty(5)
    upper = UpperFaces(grid.block, row if two else 0, float(per_dx), float(per_dy), tuple(map(float, omegas)))
    lower = (west, south, grid.block, np.empty(2 * PIECE))
    upper_fluxes(flat, cell, kernel, upper, lower, change, mx, my)
    return change, mx, my


@SETTINGS
@given(**CASES, other=PAIR, per_dy=WIDTH)
def test_upper_fluxes_in_two_directions(points, seed, both_signs, omega, per_dx, other, per_dy):
    if len(points) < 2:
        points = (*points, 5)
    grid = make_grid(points)
    rng = np.random.default_rng(seed)
    cells = random_g(grid, rng, (4, 4), both_signs)
    lower_x, lower_y = rng.normal(size=(2, *grid.points))
    pad = np.zeros(grid.block)
    west = pad.copy()
    south = np.concatenate([pad, pad])
    grid.unpack(west)[...], grid.unpack(south[grid.block :])[...] = lower_x, lower_y
    change, mx, my = run_upper(grid, cells, rng, (*omega, *other), per_dx, per_dy, west, south, True)
    east = flux_twin(grid, cells[1, :4], 0, omega, per_dx)
    north = flux_twin(grid, cells[:4, 1], 1, other, per_dy)
    for found, wanted in ((west, east), (south[grid.block :], north)):
        np.testing.assert_allclose(grid.unpack(found), wanted, rtol=1e-13, atol=1e-14 * np.abs(wanted).max())
    wanted = (lower_x - east) + (lower_y - north)
    np.testing.assert_allclose(grid.unpack(change), wanted, rtol=1e-13, atol=1e-13 * np.abs(wanted).max())
    assert not south[: grid.block].any()
    assert_moments(mx, grid, grid.unpack(west), 0, omega)
    assert_moments(my, grid, grid.unpack(south[grid.block :]), 1, other)


@SETTINGS
@given(**CASES)
def test_upper_fluxes_in_one_direction_and_none(points, seed, both_signs, omega, per_dx):
    grid = make_grid(points)
    rng = np.random.default_rng(seed)
    cells = random_g(grid, rng, (1, 4), both_signs)
    west, south = np.zeros(grid.block), np.zeros(2 * grid.block)
    change, mx, my = run_upper(grid, cells, rng, (*omega, 1.0, 1.0), per_dx, 0.0, west, south, False)
    wanted = flux_twin(grid, cells[0], 0, omega, per_dx)
    np.testing.assert_allclose(grid.unpack(west), wanted, rtol=1e-13, atol=1e-14 * np.abs(wanted).max())
    np.testing.assert_array_equal(change, -west)
    assert not my.any() and not south.any()
    assert_moments(mx, grid, grid.unpack(west), 0, omega)
    still = np.zeros(grid.block)
    change, mx, my = run_upper(grid, cells, rng, (*omega, 1.0, 1.0), 0.0, 0.0, still, south, False)
    assert not np.any([*change, *mx, *my, *still, *south])


@pytest.mark.parametrize("points", [(9, 7), (8, 6, 5), (6, 6, 8)])
def test_a_faces_bits_depend_on_the_cells_across_it_alone(points):
    """What lies along the face, and whether there is another direction at all, must not matter: so ranks agree."""
    grid, rng = make_grid(points), np.random.default_rng(3)
    cells = random_g(grid, rng, (4, 4))
    south = np.zeros(2 * grid.block)
    results = []
    for case in range(3):
        if case == 1:
            cells[[0, 2, 3]] = random_g(grid, rng, (3, 4))
        west = np.zeros(grid.block)
        row = cells[1:2] if case == 2 else cells
        omegas, per_dy = ((1.7, 1.6, 1.1, 1.2), 0.0) if case == 2 else ((1.7, 1.6, 0.9, 0.8), 3.0)
        _change, mx, _my = run_upper(grid, row, rng, omegas, 2.0, per_dy, west, south, case < 2)
        results.append(np.concatenate([west, mx]).tobytes())
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("points", [(8,), (8, 6), (6, 5, 4)])
def test_linear_profiles_are_met_exactly(points):
    """The face value of a linear profile is the mean of its neighbours: second order."""
    grid = make_grid(points)
    rng = np.random.default_rng(0)
    base, slope = random_g(grid, rng) + 20.0, rng.uniform(0.5, 1.0, grid.points)
    cells = base + np.arange(4).reshape(4, 1, 1, 1) * slope
    west, south = np.zeros(grid.block), np.zeros(2 * grid.block)
    run_upper(grid, cells[None], rng, (2.0, 2.0, 1.0, 1.0), 1.0, 0.0, west, south, False)
    xi = nodes(grid)[0]
    np.testing.assert_allclose(grid.unpack(west), 2.0 * xi * 0.5 * (cells[1] + cells[2]), rtol=1e-12)
