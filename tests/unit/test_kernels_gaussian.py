"""The discrete Gaussian and what it is made of, against plain NumPy."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy_twins import gaussian, make_grid, make_work, nodes, powers, ten_sums

from rvm_mpi.kinetic import gaussian as discrete
from rvm_mpi.kinetic import realisable
from rvm_mpi.step.data import kernel_grid

SETTINGS = settings(max_examples=40, deadline=None)
SEED = st.integers(0, 2**32 - 1)
POINTS = st.sampled_from([(8,), (7,), (9, 7), (8, 8), (8, 6, 7), (8, 8, 8), (7, 8, 9)])
PLACES = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
DIAGONAL = (0, 3, 5)


def packed(tensor):
    """A d x d tensor as xx, xy, xz, yy, yz, zz."""
    full = np.zeros((3, 3))
    full[: len(tensor), : len(tensor)] = tensor
    return np.array([full[a, b] for a, b in PLACES])


def unpacked(six):
    full = np.zeros((3, 3))
    for value, (a, b) in zip(six, PLACES, strict=True):
        full[a, b] = full[b, a] = value
    return full


def random_tensor(rng, d, low, high, twist=0.4):
    """A positive tensor whose diagonal lies in (low, high)."""
    spread = np.sqrt(rng.uniform(low, high, d))
    correlation = np.eye(d)
    for a in range(d):
        for b in range(a):
            correlation[a, b] = correlation[b, a] = rng.uniform(-twist, twist)
    return spread[:, None] * correlation * spread


def random_mean(rng, d, size):
    return np.where(np.arange(3) < d, rng.uniform(-size, size, 3), 0.0)


def least(grid, mean, axis):
    """Least variance with this mean on the nodes of an axis: all weight on the two nodes around it."""
    x = nodes(grid)[axis].ravel()
    above = int(np.searchsorted(x, mean))
    return (mean - x[above - 1]) * (x[above] - mean)


def run_gaussian(grid, density, mean, tensor):
    """(status, the grid function, the tensor as it was left, the sums that were reported)."""
    kernel = kernel_grid(grid)
    work = make_work(kernel)
    six, moments = packed(tensor), np.zeros(10)
    work.gaussian.block[:] = 7.0
    mean = np.asarray(mean, dtype=float)
    status = discrete.discrete_gaussian(density, mean, six, kernel, work.fit, work.gaussian.block, moments)
    return status, grid.unpack(work.gaussian.block), six, moments


def assert_has_moments(grid, g, density, mean, tensor, tolerance=1e-11):
    sums = ten_sums(grid, g, mean)
    size = np.sqrt(np.trace(tensor[: grid.dimensions, : grid.dimensions]))
    wanted = density * np.array([1.0, 0, 0, 0, *(tensor[a, b] for a, b in PLACES)])
    scale = density * np.array([1.0, *[size] * 3, *[size**2] * 6])
    assert np.all(np.abs(sums - wanted) <= tolerance * scale)


@SETTINGS
@given(points=POINTS, seed=SEED)
def test_ten_moments_are_met(points, seed):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    d = len(points)
    mean = random_mean(rng, d, 1.0)
    # what these grids resolve at any mean and what their box holds: variances from 0.9 to 2
    tensor = random_tensor(rng, d, 0.9, 2.0) * max(grid.spacing[:d]) ** 2 / 2.5
    density = float(10.0 ** rng.uniform(-6, 3))
    status, g, six, moments = run_gaussian(grid, density, mean, tensor)
    if status == realisable.REPLACED:
        assert any(tensor[q, q] < least(grid, mean[q], q) + 0.0101 * grid.spacing[q] ** 2 for q in range(d))
        tensor = unpacked(six)
    else:
        assert status == realisable.EXACT
        np.testing.assert_array_equal(six, packed(tensor))
    assert g.min() > 0.0
    assert_has_moments(grid, g, density, mean, unpacked(packed(tensor[:d, :d])))
    scale = np.einsum("ijk,pijk->p", g, np.abs(powers(grid)))
    assert np.all(np.abs(moments - ten_sums(grid, g)) <= 1e-11 * (scale + density))
    log = np.log(g)
    for axis in range(d):
        third = np.diff(log, n=3, axis=axis)
        assert np.abs(third).max() < 1e-8 * (1.0 + np.abs(log).max())  # the exponential of a quadratic


@settings(max_examples=20, deadline=None)
@given(points=st.sampled_from([(9,), (9, 9), (9, 8, 9)]), seed=SEED)
def test_node_by_node(points, seed):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    d = len(points)
    mean, tensor = random_mean(rng, d, 0.4), random_tensor(rng, d, 1.0, 2.5, 0.3)
    status, g, _six, _moments = run_gaussian(grid, 0.7, mean, tensor)
    assert status == realisable.EXACT
    np.testing.assert_allclose(g, gaussian(grid, 0.7, mean, tensor), rtol=1e-9)


@SETTINGS
@given(points=st.sampled_from([(8, 8), (8, 6, 7), (9, 8, 8)]), seed=SEED)
def test_an_axis_too_cold_for_the_grid_borrows_from_the_others(points, seed):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    d = len(points)
    mean = random_mean(rng, d, 1.0)
    tensor = random_tensor(rng, d, 2.2, 3.0, 0.3)
    cold = int(rng.integers(d))
    x = nodes(grid)[cold].ravel()
    mean[cold] = x[len(x) // 2] + grid.spacing[cold] * rng.uniform(0.2, 0.8)  # between two nodes
    factor = np.ones(d)
    factor[cold] = np.sqrt(0.5 * least(grid, mean[cold], cold) / tensor[cold, cold])
    tensor = factor[:, None] * tensor * factor
    status, g, six, _moments = run_gaussian(grid, 2.0, mean, tensor)
    assert status == realisable.REPLACED
    left = unpacked(six)
    assert abs(np.trace(left) / np.trace(tensor) - 1.0) < 1e-14
    assert g.min() > 0.0
    assert_has_moments(grid, g, 2.0, mean, left)
    assert left[cold, cold] >= least(grid, mean[cold], cold)


@pytest.mark.parametrize("points", [(8,), (8, 8), (8, 8, 8)])
def test_too_cold_or_out_of_the_box(points):
    grid, d = make_grid(points), len(points)
    still = np.zeros(3)
    assert run_gaussian(grid, 1.0, still, 0.7 * np.eye(d))[0] == realisable.TOO_COLD  # nodes at +-0.875: 0.766
    assert run_gaussian(grid, 1.0, still, 0.8 * np.eye(d))[0] == realisable.EXACT
    assert run_gaussian(grid, 1.0, np.array([6.2, 0, 0]), np.eye(d))[0] == realisable.TOO_COLD
    assert run_gaussian(grid, 1.0, np.array([np.nan, 0, 0]), np.eye(d))[0] == realisable.TOO_COLD
    assert run_gaussian(grid, 1.0, still, np.nan * np.eye(d))[0] >= realisable.TOO_COLD
    assert run_gaussian(grid, 1.0, still, 60.0 * np.eye(d))[0] == discrete.FAILED  # hotter than the box


def test_a_tensor_that_is_not_positive_fails():
    tensor = np.array([[1.5, 2.0, 0.0], [2.0, 1.5, 0.0], [0.0, 0.0, 1.5]])
    assert run_gaussian(make_grid((8, 8, 8)), 1.0, np.zeros(3), tensor)[0] == discrete.FAILED


@SETTINGS
@given(seed=SEED, d=st.integers(1, 3))
def test_determinant_and_inverse(seed, d):
    tensor = random_tensor(np.random.default_rng(seed), d, 0.1, 3.0)
    inverse = np.full(6, 9.0)
    assert realisable.determinant(packed(tensor), d) == pytest.approx(np.linalg.det(tensor), rel=1e-12)
    assert realisable.invert_tensor(packed(tensor), d, inverse)
    np.testing.assert_allclose(inverse, packed(np.linalg.inv(tensor)), rtol=1e-11, atol=1e-13)
    assert not realisable.invert_tensor(packed(-tensor), d, inverse)


@SETTINGS
@given(points=POINTS, seed=SEED)
def test_smallest_variance_and_the_realisable_tensor(points, seed):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    kernel, d = kernel_grid(grid), len(points)
    mean = random_mean(rng, d, 4.0)
    floors = np.array([least(grid, mean[q], q) for q in range(d)])
    for q in range(d):
        found = realisable.smallest_variance(kernel.nodes[q], grid.points[q], mean[q])
        assert found == pytest.approx(floors[q], abs=1e-13)
    tensor = random_tensor(rng, d, 0.05, 1.5)
    six = packed(tensor)
    status = realisable.realisable_tensor(mean, six, kernel)
    raised = floors + realisable.ROOM * np.array(grid.spacing[:d]) ** 2
    if np.all(np.diag(tensor) >= raised):
        assert status == realisable.EXACT
        np.testing.assert_array_equal(six, packed(tensor))
    elif np.trace(tensor) <= raised.sum():
        assert status == realisable.TOO_COLD
    else:
        assert status == realisable.REPLACED
        left = unpacked(six)[:d, :d]
        assert np.trace(left) == pytest.approx(np.trace(tensor), rel=1e-13)
        assert np.all(np.diag(left) >= raised - 1e-13)
        assert np.linalg.eigvalsh(left).min() > 0.0


@SETTINGS
@given(n=st.integers(4, 30), mean=st.floats(-2.0, 2.0), variance=st.floats(0.5, 4.0))
def test_fit_axis(n, mean, variance):
    grid = make_grid((n,))
    x = nodes(grid)[0].ravel()
    if variance < 1.05 * least(grid, mean, 0) + 0.02 * grid.spacing[0] ** 2:
        return
    result = np.zeros(3)
    discrete.fit_axis(kernel_grid(grid).nodes[0], n, mean, variance, result)
    s = x - mean
    w = np.exp(result[1] * s + result[0] * s * s)
    assert result[2] == pytest.approx(w.sum(), rel=1e-12)
    wanted = gaussian(grid, 1.0, [mean, 0, 0], np.array([[variance]])).ravel()
    np.testing.assert_allclose(w / w.sum(), wanted, atol=1e-7)


@SETTINGS
@given(points=POINTS, seed=SEED)
def test_gaussian_sums(points, seed):
    """All sums to fourth order that Newton's matrix is made of."""
    grid, rng = make_grid(points), np.random.default_rng(seed)
    kernel, d = kernel_grid(grid), len(points)
    centre = random_mean(rng, d, 1.0)
    g = rng.random(grid.points)
    block = np.zeros(grid.block)
    grid.unpack(block)[...] = g
    sums = np.zeros(75)
    discrete.gaussian_sums(centre, kernel, block, sums, make_work(kernel).fit.plane)
    p = powers(grid, centre)
    wanted = np.einsum("ijk,pijk,qijk->pq", g, p, p)
    scale = np.einsum("ijk,pijk,qijk->pq", g, np.abs(p), np.abs(p))
    assert np.all(np.abs(sums[discrete._PRODUCT] - wanted) <= 1e-14 * scale)


def test_gaussian_moments():
    grid, rng = make_grid((8, 7, 5)), np.random.default_rng(0)
    kernel = kernel_grid(grid)
    theta = np.array([0.2, *(0.1 * rng.normal(size=3)), -0.3, 0.05, -0.04, -0.2, 0.03, -0.4])
    centre, block, moments = np.array([0.3, -0.2, 0.1]), np.zeros(grid.block), np.zeros(10)
    discrete.gaussian_moments(theta, centre, kernel, block, moments)
    wanted = np.exp(np.einsum("p,pijk->ijk", theta, powers(grid, centre)))
    np.testing.assert_allclose(grid.unpack(block), wanted, rtol=1e-12)
    np.testing.assert_allclose(moments, ten_sums(grid, wanted, centre), rtol=1e-11, atol=1e-12 * wanted.sum())


@SETTINGS
@given(seed=SEED, off=st.floats(-0.5, 0.5), room=st.floats(0.0101, 0.3), d=st.integers(1, 3))
@example(seed=126, off=0.00486, room=0.0101, d=1)
@example(seed=126, off=0.00486, room=0.0101, d=2)
@example(seed=126, off=-0.005, room=0.0125, d=2)
def test_an_axis_as_cold_as_the_grid_allows(seed, off, room, d):
    """Nearly all of the gas on one or two nodes of an axis, wherever the mean lies between them."""
    grid, rng = make_grid((8,) * d), np.random.default_rng(seed)
    h = grid.spacing[0]
    mean = random_mean(rng, d, 1.0)
    mean[0] = nodes(grid)[0].ravel()[4] + off * h
    tensor = random_tensor(rng, d, 1.2, 3.0, 0.2)
    factor = np.ones(d)
    factor[0] = np.sqrt((least(grid, mean[0], 0) + room * h * h) / tensor[0, 0])
    tensor = factor[:, None] * tensor * factor
    status, g, six, _moments = run_gaussian(grid, 1.0, mean, tensor)
    assert status <= realisable.REPLACED
    assert_has_moments(grid, g, 1.0, mean, unpacked(six))
