"""The drift in velocity space and the update of a block, against plain NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy_twins import SHAPES, drift_rate, laid_out, make_grid, pack, random_g

from rvm_mpi.kinetic import drift
from rvm_mpi.stage import Work, kernel_grid

SETTINGS = settings(max_examples=60, deadline=None)
RATE = st.floats(-3.0, 3.0)


def run(grid, g, before, rate, rates, weights, dt, kappa, rng, work=None):
    """The updated block, of the middle one of three cells."""
    kernel = kernel_grid(grid)
    flat, at = laid_out(grid, np.stack([random_g(grid, rng), g, random_g(grid, rng)]), rng)
    old, _ = laid_out(grid, np.stack([g, before, g]), rng)
    result = pack(grid, rate)
    work = work or Work.create(kernel, 1)
    numbers = np.array([*rates, *kernel.per_spacing])
    drift.update(
        flat, at + grid.block, grid.points, grid.slab_size, kernel.x, kernel.x_face, kernel.slab, numbers, old,
        *weights, dt, kappa, work.scratch, result,
    )  # fmt: skip
    return grid.unpack(result)


def in_use(d):
    """Which of the turning rate, omega's gradients along x and y (up, down each) and the pushes occur."""
    return np.array([1, 1, 1, d > 1, d > 1, 1, d > 1, d > 2])


@SETTINGS
@given(
    points=st.sampled_from(SHAPES),
    seed=st.integers(0, 2**32 - 1),
    signed=st.booleans(),
    kappa=st.booleans(),
    rates=st.tuples(*[RATE] * 8),
    dt=st.floats(0.0, 0.5),
    second=st.booleans(),
    z=st.floats(0.0, 5.0),
)
def test_update(points, seed, signed, kappa, rates, dt, second, z):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    d = len(points)
    # omega's gradient along y and pushes along directions that are not there do not occur
    rates = np.array(rates) * in_use(d)
    g, before, rate = (random_g(grid, rng, signed=signed) for _ in range(3))
    weights = (0.5, 0.5 * (1.0 + z)) if second else (0.0, 1.0)
    found = run(grid, g, before, rate, rates, weights, dt, kappa, rng)
    total = rate + drift_rate(grid, g, rates[0], rates[1:5].reshape(2, 2), rates[5:], kappa)
    wanted = weights[0] * before + weights[1] * (g + dt * total)
    size = np.abs(g).max() * (1.0 + 100.0 * dt * sum(map(abs, rates))) + dt * np.abs(rate).max() + np.abs(before).max()
    np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-14 * size * weights[1] * 10)


@pytest.mark.parametrize("kappa", [False, True])
@pytest.mark.parametrize("points", SHAPES)
def test_mass_stays_in_the_box(points, kappa):
    grid, rng = make_grid(points), np.random.default_rng(1)
    g = random_g(grid, rng)
    rates = np.array([0.7, -0.3, -0.2, 0.4, 0.6, 0.5, 0.5, 0.5]) * in_use(len(points))
    found = run(grid, g, g, 0.0 * g, rates, (0.0, 1.0), 0.1, kappa, rng)
    assert abs(found.sum() / g.sum() - 1.0) < 1e-14
    assert np.abs(found - g).max() > 1e-3


@pytest.mark.parametrize("points", SHAPES)
def test_nothing_moves_where_scaling_and_drag_cancel(points):
    grid, rng = make_grid(points), np.random.default_rng(2)
    g = random_g(grid, rng)
    found = run(grid, g, g, 0.0 * g, (0.0,) * 8, (0.0, 1.0), 0.3, False, rng)
    np.testing.assert_array_equal(found, g)


@pytest.mark.parametrize("points", SHAPES)
def test_positive_up_to_courant_number_one_half(points):
    grid, rng = make_grid(points), np.random.default_rng(4)
    for _ in range(20):
        g = random_g(grid, rng) * (rng.random(grid.points) < 0.5)
        rates = rng.uniform(-1, 1, 8) * in_use(len(points))
        turning = abs(rates[0]) + 7.0 * (np.abs(rates[1:3]).max() + np.abs(rates[3:5]).max())
        courant = sum((7.0 * turning + abs(rates[5 + q])) / grid.spacing[q] for q in range(len(points)))
        found = run(grid, g, g, 0.0 * g, rates, (0.0, 1.0), 0.5 / courant, False, rng)
        assert found.min() >= -1e-16 * g.max()


def test_work_space_carries_nothing_from_one_cell_to_the_next():
    grid, rng = make_grid((8, 6, 5)), np.random.default_rng(5)
    work = Work.create(kernel_grid(grid), 1)
    g, rates = random_g(grid, rng), (0.5, 0.2, 0.3, -0.3, -0.1, 0.1, 0.2, 0.3)
    alone = run(grid, g, g, g, rates, (0.0, 1.0), 0.1, False, rng)
    run(grid, 1e6 * random_g(grid, rng), g, g, rates, (0.5, 0.5), 0.1, False, rng, work)
    np.testing.assert_array_equal(run(grid, g, g, g, rates, (0.0, 1.0), 0.1, False, rng, work), alone)
