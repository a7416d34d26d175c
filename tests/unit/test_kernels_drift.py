"""The drift in velocity space and the update of a block, against plain NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy_twins import (
    SHAPES,
    STILL,
    drift_rate,
    kernel_drift,
    laid_out,
    make_grid,
    make_work,
    nodes,
    pack,
    problem,
    random_g,
    turning_of,
)  # fmt: skip

from rvm_mpi.kinetic import drift
from rvm_mpi.step.data import kernel_grid

SETTINGS = settings(max_examples=60, deadline=None)
RATE = st.floats(-3.0, 3.0)

#: whose slabs are gone through in two pieces and more, the last of them a short one
LARGE = [(3, 270), (4, 18, 16), (4, 20, 15), (3, 25, 24)]
RECONSTRUCTIONS = list(drift.RECONSTRUCTIONS)


def run(grid, g, before, rate, rates, weights, dt, rng, name="van-leer", work=None, turn=None):
    """The updated block, of the middle one of three cells; `turn` a `Drift` for the rates."""
    kernel = kernel_grid(grid, name)
    flat, at = laid_out(grid, np.stack([random_g(grid, rng), g, random_g(grid, rng)]), rng)
    old, _ = laid_out(grid, np.stack([g, before, g]), rng)
    result = pack(grid, rate)
    work = work or make_work(kernel)
    turn = turn or kernel_drift(grid, rates)
    mix = drift.Mix(old, float(weights[0]), float(weights[1]), float(dt))
    drift.apply(flat, at + grid.block, kernel, turn, mix, work.scratch, result)
    return grid.unpack(result)


def in_use(d):
    """Which of the turning rate, omega's gradients along x and y (up, down each) and the pushes occur."""
    return np.array([1, 1, 1, d > 1, d > 1, 1, d > 1, d > 2])


@SETTINGS
@given(
    points=st.sampled_from([*SHAPES, *LARGE]),
    seed=st.integers(0, 2**32 - 1),
    signed=st.booleans(),
    name=st.sampled_from(RECONSTRUCTIONS),
    rates=st.tuples(*[RATE] * 8),
    dt=st.floats(0.0, 0.5),
    second=st.booleans(),
    z=st.floats(0.0, 5.0),
    mean=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    temperature=st.floats(0.8, 3.0),
    moves=st.booleans(),
)
def test_update(points, seed, signed, name, rates, dt, second, z, mean, temperature, moves):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    d = len(points)
    # omega's gradient along y and pushes along directions that are not there do not occur
    rates = np.array(rates) * in_use(d)
    g, before, rate = (random_g(grid, rng, signed=signed) for _ in range(3))
    weights = (0.5, 0.5 * (1.0 + z)) if second else (0.0, 1.0)
    state = (tuple(float(u) * (q < d) for q, u in enumerate(mean)), temperature)
    moving = random_moving(rng, d) if moves and name == "maxwellian" else STILL
    turn = kernel_drift(grid, rates, state, moving)
    found = run(grid, g, before, rate, rates, weights, dt, rng, name, turn=turn)
    total = rate + drift_rate(grid, g, turning_of(rates, state, moving), name, (g + dt * rate) / max(dt, 1e-300))
    wanted = weights[0] * before + weights[1] * (g + dt * total)
    fastest = 100.0 * (np.abs(rates).sum() + np.abs(moving[1]).sum()) * (1.0 + 0.2 * np.abs(moving[0]).max())
    size = np.abs(g).max() * (1.0 + dt * fastest) + dt * np.abs(rate).max() + np.abs(before).max()
    # of g over a Gaussian, random over many powers of ten, differences lose digits
    rounding = 1e5 if name == "maxwellian" else 1.0
    np.testing.assert_allclose(found, wanted, rtol=1e-13 * rounding, atol=1e-13 * rounding * size * weights[1])


def random_moving(rng, d):
    """A flow, at rest or far outside the box, and shears, as far as d velocities have them."""
    flow = rng.choice([0.0, 1.0, 12.0]) * rng.normal(size=3) * (np.arange(3) < min(d, 2))
    shears = rng.normal(size=(2, 2, 3)) * (np.arange(3) < d)
    shears[1] *= d > 1
    return flow, shears


@SETTINGS
@given(points=st.sampled_from(SHAPES), seed=st.integers(0, 2**32 - 1))
def test_fastest_with_flow_bounds_every_speed(points, seed):
    """As the reference has it, and no node or face is faster, nor the box's edge."""
    grid, rng = make_grid(points), np.random.default_rng(seed)
    d = len(points)
    rates, moving = rng.normal(size=8) * in_use(d), random_moving(rng, d)
    moving[0][:1] += 1e-3  # never nothing at all
    turn, turning = kernel_drift(grid, rates, moving=moving), turning_of(rates, moving=moving)
    edges = [np.concatenate([x.ravel(), [-v, v]]) for x, v in zip(nodes(grid), grid.half_width)]
    at = np.meshgrid(*edges, indexing="ij", sparse=True)
    for q in range(d):
        assert turn.fastest[q] == pytest.approx(turning.fastest(problem(grid), q)[0, 0], rel=1e-13)
        assert np.abs(turning.speed(q, at)).max() <= turn.fastest[q] * grid.spacing[q] * (1.0 + 1e-13)
    assert not any(turn.fastest[d:])


@pytest.mark.parametrize("name", RECONSTRUCTIONS)
@pytest.mark.parametrize("points", [*SHAPES, *LARGE])
def test_mass_stays_in_the_box(points, name):
    grid, rng = make_grid(points), np.random.default_rng(1)
    g = random_g(grid, rng)
    rates = np.array([0.7, -0.3, -0.2, 0.4, 0.6, 0.5, 0.5, 0.5]) * in_use(len(points))
    found = run(grid, g, g, 0.0 * g, rates, (0.0, 1.0), 0.1, rng, name)
    assert abs(found.sum() / g.sum() - 1.0) < 1e-14
    assert np.abs(found - g).max() > 1e-3


@pytest.mark.parametrize("name", RECONSTRUCTIONS)
@pytest.mark.parametrize("points", SHAPES)
def test_nothing_moves_where_scaling_and_drag_cancel(points, name):
    grid, rng = make_grid(points), np.random.default_rng(2)
    g = random_g(grid, rng)
    found = run(grid, g, g, 0.0 * g, (0.0,) * 8, (0.0, 1.0), 0.3, rng, name)
    np.testing.assert_array_equal(found, g)


@pytest.mark.parametrize("name", drift.KEEP_POSITIVE)
@pytest.mark.parametrize("points", SHAPES)
def test_positive_up_to_courant_number_one_half(points, name):
    grid, rng = make_grid(points), np.random.default_rng(4)
    for _ in range(20):
        g = random_g(grid, rng) * (rng.random(grid.points) < 0.5)
        rates = rng.uniform(-1, 1, 8) * in_use(len(points))
        turning = abs(rates[0]) + 7.0 * (np.abs(rates[1:3]).max() + np.abs(rates[3:5]).max())
        courant = sum((7.0 * turning + abs(rates[5 + q])) / grid.spacing[q] for q in range(len(points)))
        found = run(grid, g, g, 0.0 * g, rates, (0.0, 1.0), 0.5 / courant, rng, name)
        assert found.min() >= -1e-16 * g.max()


@pytest.mark.parametrize("points", SHAPES)
def test_positive_where_the_gas_flows_and_shears(points):
    grid, rng = make_grid(points), np.random.default_rng(7)
    for _ in range(20):
        g, d = random_g(grid, rng) * (rng.random(grid.points) < 0.5), len(points)
        turn = kernel_drift(grid, rng.uniform(-1, 1, 8) * in_use(d), moving=random_moving(rng, d))
        found = run(grid, g, g, 0.0 * g, (0.0,) * 8, (0.0, 1.0), 0.5 / sum(turn.fastest), rng, "maxwellian", turn=turn)
        assert found.min() >= -1e-16 * g.max()
        assert abs(found.sum() - g.sum()) <= 1e-14 * g.sum()


@pytest.mark.parametrize("points", [(8, 6, 5), (4, 20, 15)])
@pytest.mark.parametrize("name", RECONSTRUCTIONS)
def test_work_space_carries_nothing_from_one_cell_to_the_next(name, points):
    grid, rng = make_grid(points), np.random.default_rng(5)
    work = make_work(kernel_grid(grid))
    g, rates = random_g(grid, rng), (0.5, 0.2, 0.3, -0.3, -0.1, 0.1, 0.2, 0.3)
    alone = run(grid, g, g, g, rates, (0.0, 1.0), 0.1, rng, name)
    run(grid, 1e6 * random_g(grid, rng), g, g, rates, (0.5, 0.5), 0.1, rng, name, work)
    np.testing.assert_array_equal(run(grid, g, g, g, rates, (0.0, 1.0), 0.1, rng, name, work), alone)


def rate_of_change(grid, g, rates, name):
    """-div_xi (a g) as the kernel has it."""
    rng = np.random.default_rng(6)
    return run(grid, g, g, 0.0 * g, rates, (0.0, 1.0), 1.0, rng, name) - g


@pytest.mark.parametrize(("name", "order"), drift.ORDERS.items())
@pytest.mark.parametrize(
    "rates", [(0.8, 0, 0, 0, 0, 0.3, 0, 0), (0, 0.4, 0.4, 0, 0, 0, 0, 0)], ids=["dilation", "gradient"]
)
def test_order_of_a_linear_reconstruction(name, order, rates):
    errors = []
    for points in (48, 96):
        grid = make_grid((points,), 8.0)
        xi = grid.x[:, None, None]
        g = np.exp(-0.5 * (xi - 0.7) ** 2)
        turning, push = rates[0] + rates[1] * xi, rates[5]
        exact = (turning + rates[1] * xi) * g + (-turning * xi + push) * (xi - 0.7) * g
        errors.append(np.abs(rate_of_change(grid, g, rates, name) - exact).sum() * grid.weight)
    assert np.log2(errors[0] / errors[1]) > order - 0.6


@pytest.mark.parametrize(
    ("name", "ceilings"),
    [("seventh-order", (1e-9, 6e-4)), ("seventh-order-positive", (1e-5, 2e-3))],
)
def test_heat_flux_and_fourth_moment_on_a_coarse_grid(name, ceilings):
    """A gradient of omega makes the heat flux it should, a dilation leaves a Maxwellian's fourth cumulant."""
    grid = make_grid((32,), 9.0)
    xi = grid.x[:, None, None]
    g = np.exp(-0.5 * xi**2) / np.sqrt(2 * np.pi)
    gradient = rate_of_change(grid, g, (0, 1.0, 1.0, 0, 0, 0, 0, 0), name)
    dilation = rate_of_change(grid, g, (1.0, 0, 0, 0, 0, 0, 0, 0), name)
    # d_t <xi^3> = -3 <xi^4> = -9, d_t <xi^4> = -4 <xi^4> = -12, the latter beside d_t <xi^2> = -2
    third, fourth, second = (np.sum(xi**n * r) * grid.weight for n, r in ((3, gradient), (4, dilation), (2, dilation)))
    assert third == pytest.approx(-9.0, rel=ceilings[0])
    assert fourth / second == pytest.approx(6.0, rel=ceilings[1])
