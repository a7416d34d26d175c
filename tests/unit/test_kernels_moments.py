"""The velocity grid, and the moments of f from those of g, against sums over the nodes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy_twins import SHAPES, make_grid, nodes, pack, random_g, ten_sums

from rvm_mpi.grid import velocity
from rvm_mpi.grid.velocity import LEAST
from rvm_mpi.kinetic.moments import fields, sums_about
from rvm_mpi.step.data import Space, kernel_grid

SETTINGS = settings(max_examples=40, deadline=None)


@pytest.mark.parametrize("points", SHAPES)
def test_velocity_grid(points):
    widths = tuple(5.0 + q for q in range(len(points)))
    grid = velocity.VelocityGrid.create(points, widths)
    assert grid.points == (*points, 1, 1)[:3]
    assert grid.slab_size % 8 == 0 and 0 <= grid.slab_size - grid.slab_points < 8
    assert grid.weight == pytest.approx(np.prod([2 * v / n for n, v in zip(points, widths, strict=True)]), rel=1e-15)
    x, y, z = (np.broadcast_to(axis, grid.points) for axis in nodes(grid))
    slab = grid.slab[:, : grid.slab_points].reshape(-1, *grid.points[1:])
    np.testing.assert_array_equal(grid.x, x[:, 0, 0])
    np.testing.assert_allclose(slab[velocity.Y], y[0], atol=1e-14)
    np.testing.assert_allclose(slab[velocity.Z], z[0], atol=1e-14)
    np.testing.assert_allclose(grid.x_face, grid.x + 0.5 * grid.spacing[0], atol=1e-14)
    for row, axis in ((velocity.Y_OPEN, 0), (velocity.Z_OPEN, 1)):
        index = np.indices(grid.points[1:])[axis]
        np.testing.assert_array_equal(slab[row], index < grid.points[1 + axis] - 1)
    for row, axis, node in ((velocity.Y_FACE, 0, y[0]), (velocity.Z_FACE, 1, z[0])):
        inside = np.indices(grid.points[1:])[axis] < grid.points[1 + axis] - 1
        np.testing.assert_allclose(slab[row], (node + 0.5 * grid.spacing[1 + axis]) * inside, atol=1e-14)
    for row, axis in ((velocity.Y_LEAST, 0), (velocity.Z_LEAST, 1)):
        index = np.indices(grid.points[1:])[axis]
        inner = (index > 0) & (index < grid.points[1 + axis] - 1)
        np.testing.assert_array_equal(slab[row], np.where(inner, LEAST, np.inf))
        assert np.all(grid.slab[row, grid.slab_points :] == np.inf)
    at_end = [(np.indices(grid.points[1:])[q] % max(n - 1, 1) == 0) & (n > 1) for q, n in enumerate(grid.points[1:])]
    np.testing.assert_array_equal(slab[velocity.EDGE], at_end[0] | at_end[1])
    np.testing.assert_allclose(slab[velocity.SPEED2], y[0] ** 2 + z[0] ** 2, rtol=1e-14)
    for row in (velocity.Y, velocity.Z, velocity.VALID, velocity.Y_OPEN, velocity.Z_OPEN, velocity.Y_FACE):
        assert not grid.slab[row, grid.slab_points :].any()
    assert not grid.slab[velocity.EDGE, grid.slab_points :].any()
    assert np.all(slab[velocity.VALID] == 1.0)
    # nodes and faces mirror to the last bit, so that symmetric states stay symmetric
    for q, n in enumerate(points):
        np.testing.assert_array_equal(grid.nodes[q, :n], -grid.nodes[q, :n][::-1])
    np.testing.assert_array_equal(grid.x_face[:-1], -grid.x_face[:-1][::-1])


@pytest.mark.parametrize("points", SHAPES)
def test_unpack_is_the_inverse_of_packing(points):
    grid = make_grid(points)
    values = random_g(grid, np.random.default_rng(0), (2, 3))
    np.testing.assert_array_equal(grid.unpack(pack(grid, values)), values)


def ghosted(grid, rng, signed=False):
    """A field of 3 x 2 cells in a frame of ghosts, its layout, and the cells."""
    blocks = rng.normal(size=(7, 6, grid.block))
    cells = random_g(grid, rng, (3, 2), signed)
    blocks[2:5, 2:4] = pack(grid, cells)
    return blocks, Space(2, 2, 3, 2, 2, 1.0, 1.0), cells


@SETTINGS
@given(points=st.sampled_from(SHAPES), seed=st.integers(0, 2**32 - 1), signed=st.booleans())
def test_sums_about_the_origin(points, seed, signed):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    blocks, space, cells = ghosted(grid, rng, signed)
    found = sums_about(blocks, space, kernel_grid(grid), np.zeros((3, 2, 3)))[..., :10]
    scale = ten_sums(grid, np.abs(cells))[..., :1] * 49.0
    assert np.all(np.abs(found - ten_sums(grid, cells)) <= 1e-14 * scale)


@SETTINGS
@given(points=st.sampled_from(SHAPES), seed=st.integers(0, 2**32 - 1))
def test_fields(points, seed):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    d = len(points)
    blocks, space, cells = ghosted(grid, rng)
    omega = rng.uniform(0.3, 3.0, (3, 2))
    counted_from = rng.choice([0.0, 1.0, 5.0]) * rng.normal(size=(3, 2, 3)) * (np.arange(3) < d)
    found = fields(blocks, (omega, counted_from), ten_sums(grid, cells), space, kernel_grid(grid))
    for at in np.ndindex(3, 2):
        # f on its own nodes v = u + omega xi, with weights omega^d
        own = zip(counted_from[at], nodes(grid)[:d])
        v = np.array([np.broadcast_to(u + omega[at] * axis, grid.points) for u, axis in own])
        f = cells[at] * omega[at] ** -d
        weight = grid.weight * omega[at] ** d
        rho = weight * f.sum()
        u = weight * np.einsum("ijk,aijk->a", f, v) / rho
        c = v - u[:, None, None, None]
        theta = weight * np.einsum("ijk,aijk,bijk->ab", f, c, c) / rho
        heat = 0.5 * weight * np.einsum("ijk,aijk,bijk->a", f, c, c**2)
        size = np.sqrt(np.trace(theta))
        assert found["density"][at] == pytest.approx(rho, rel=1e-13)
        np.testing.assert_allclose(found["velocity"][at], u, rtol=1e-14, atol=1e-13 * 10 * size)
        np.testing.assert_allclose(found["stress"][at], theta, atol=1e-12 * size**2)
        assert found["temperature"][at] == pytest.approx(np.trace(theta) / d, rel=1e-12)
        np.testing.assert_allclose(found["heat_flux"][at], heat, atol=1e-12 * rho * 10 * size**3)
