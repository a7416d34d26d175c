"""Moments of a block and the correction that makes them exact, against plain NumPy."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy_twins import SHAPES, corrected, make_grid, nodes, pack, powers, random_g, ten_sums

from rvm_mpi.kinetic.conservation import (
    SUMS,
    Correction,
    about_origin,
    add_correction,
    correct,
    factor_tables,
    solve,
    weighted_sums,
)
from rvm_mpi.step.data import kernel_grid

SETTINGS = settings(max_examples=40, deadline=None)
SEED = st.integers(0, 2**32 - 1)
POINTS = st.sampled_from(SHAPES)


def five(grid, g):
    """Sums of 1, xi, |xi|^2/2."""
    s = ten_sums(grid, g)
    return np.array([*s[:4], 0.5 * (s[4] + s[7] + s[9])])


@SETTINGS
@given(points=POINTS, seed=SEED, signed=st.booleans())
def test_weighted_sums(points, seed, signed):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    kernel, d = kernel_grid(grid), len(points)
    centre = np.array([*rng.normal(size=d), *np.zeros(3 - d)])
    g, fx, fs = random_g(grid, rng, signed=signed), rng.random(grid.points[0]), rng.random(grid.slab_size)
    sums = np.empty(SUMS)
    work = Correction.ones(kernel)._replace(factor_x=fx, factor_slab=fs)
    weighted_sums(pack(grid, g), centre, kernel, work, sums)
    factor = fx[:, None, None] * fs[: grid.slab_points].reshape(1, *grid.points[1:])
    x, y, z = (axis - c for axis, c in zip(nodes(grid), centre))
    square = x * x + y * y + z * z
    basis = np.array([*powers(grid, centre), x * square, y * square, z * square, square * square])
    wanted = np.einsum("ijk,pijk->p", g * factor, basis)
    scale = np.einsum("ijk,pijk->p", np.abs(g * factor), np.abs(basis))
    assert np.all(np.abs(sums - wanted) <= 1e-14 * scale)


@SETTINGS
@given(points=POINTS, seed=SEED)
def test_about_origin(points, seed):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    g, centre = random_g(grid, rng), rng.normal(size=3)
    sums = np.concatenate([ten_sums(grid, g, centre), np.zeros(4)])
    about_origin(sums, centre)
    scale = np.einsum("ijk,pijk->p", g, np.abs(powers(grid, -np.abs(centre)))) + g.sum() * 10
    assert np.all(np.abs(sums[:10] - ten_sums(grid, g)) <= 1e-14 * scale)


@SETTINGS
@given(n=st.integers(1, 10), seed=SEED, left_out=st.integers(0, 9))
def test_solve(n, seed, left_out):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n + 2))
    matrix, vector = root @ root.T, rng.normal(size=n)
    keep = np.ones(n, dtype=bool)
    if n > 1 and left_out < n:
        keep[left_out] = False
        matrix[left_out, :] = matrix[:, left_out] = 0.0
    wanted = np.zeros(n)
    wanted[keep] = np.linalg.solve(matrix[np.ix_(keep, keep)], vector[keep])
    space = np.full((11, 11), 5.0)
    space[:n, :n] = matrix
    result = vector.copy()
    assert solve(space, result, n)
    condition = np.linalg.cond(matrix[np.ix_(keep, keep)])
    np.testing.assert_allclose(result, wanted, atol=1e-14 * condition * np.abs(wanted).max(), rtol=0)


def test_solve_refuses_what_is_not_positive():
    for matrix in ([[-1.0, 0.0], [0.0, 1.0]], [[1.0, 2.0], [2.0, 1.0]], [[np.nan, 0.0], [0.0, 1.0]]):
        assert not solve(np.array(matrix), np.ones(2), 2)


@SETTINGS
@given(points=POINTS, seed=SEED)
def test_factor_tables(points, seed):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    kernel, d = kernel_grid(grid), len(points)
    c = np.array([0.3, *(0.2 * rng.normal(size=d)), *np.zeros(3 - d), -0.1 * rng.random()])
    centre = np.array([*rng.normal(size=d), *np.zeros(3 - d)])
    work = Correction.ones(kernel)._replace(coefficients=c, centre=centre)
    factor_tables(kernel, work)
    fx, fs = work.factor_x, work.factor_slab
    x = [axis - m for axis, m in zip(nodes(grid), centre)]
    wanted = np.exp(c[0] + sum(c[1 + q] * x[q] + c[4] * x[q] ** 2 for q in range(3)))
    found = fx[:, None, None] * fs[: grid.slab_points].reshape(1, *grid.points[1:])
    np.testing.assert_allclose(found, wanted, rtol=1e-13)


def run_correct(grid, g, target):
    """(what `correct` says, the factor, the sums it reports)."""
    kernel = kernel_grid(grid)
    work, sums = Correction.ones(kernel), np.zeros(SUMS)
    answer = correct(pack(grid, g), target, kernel, work, sums)
    fx, fs = work.factor_x, work.factor_slab
    return answer, fx[:, None, None] * fs[: grid.slab_points].reshape(1, *grid.points[1:]), sums[:10]


def gas(grid, rng, thermal=1.0):
    """A rough distribution of about unit temperature, and its mean."""
    mean = np.where(np.arange(3) < grid.dimensions, 0.3 * rng.normal(size=3), 0.0)
    square = sum((axis - m) ** 2 for axis, m in zip(nodes(grid), mean))
    return rng.uniform(0.5, 1.5, grid.points) * np.exp(-0.5 * square / thermal)


def nearby(grid, g, rng, size):
    """Moments a little different from those of g."""
    target = five(grid, g)
    density = target[0] * (1.0 + size * rng.uniform(-1, 1))
    mean = target[1:4] / target[0]
    spread = 2.0 * target[4] / target[0] - mean @ mean
    mean = mean + np.where(np.arange(3) < grid.dimensions, size * rng.uniform(-1, 1, 3), 0.0)
    spread *= 1.0 + size * rng.uniform(-1, 1)
    return density * np.array([1.0, *mean, 0.5 * (spread + mean @ mean)])


@SETTINGS
@given(points=POINTS, seed=SEED, size=st.sampled_from([0.0, 1e-12, 1e-8, 1e-4, 1e-2, 0.2]))
def test_correction(points, seed, size):
    grid, rng = make_grid(points, 5.0), np.random.default_rng(seed)
    g = gas(grid, rng, 1.5)
    target = nearby(grid, g, rng, size)
    answer, factor, sums = run_correct(grid, g, target)
    assert 0.0 <= answer <= 3.0 * size + 1e-13
    assert factor.min() > 0.0
    result = g * factor
    scale = target[0] * np.array([1, 1, 1, 1, 2.0])
    assert np.all(np.abs(five(grid, result) - target) <= 1e-12 * scale)
    np.testing.assert_allclose(factor, corrected(grid, g, target) / g, rtol=1e-9)
    # what is reported without another look: mass, momentum and energy to round-off, the rest to Newton's last step
    assert np.all(np.abs(np.array([*sums[:4], 0.5 * (sums[4] + sums[7] + sums[9])]) - target) <= 1e-12 * scale)
    assert np.all(np.abs(sums - ten_sums(grid, result)) <= 3e-8 * target[0])


@SETTINGS
@given(seed=SEED, points=st.sampled_from([(16,), (12, 10), (8, 8, 8)]))
def test_correction_of_a_g_that_dips_below_zero(seed, points):
    grid, rng = make_grid(points, 5.0), np.random.default_rng(seed)
    g = gas(grid, rng, 1.5) - 1e-4 * rng.random(grid.points)
    assume(g.min() < 0.0)
    target = nearby(grid, g, rng, 1e-2)
    answer, factor, _sums = run_correct(grid, g, target)
    assert answer >= 0.0
    assert np.array_equal(np.sign(g), np.sign(g * factor))
    assert np.all(np.abs(five(grid, g * factor) - target) <= 1e-12 * 2 * target[0])


def plain_newton(grid, g, target, steps):
    """Mismatch before each Newton step, every step shortened to a reach of 2 but taken whole."""
    d, one = grid.dimensions, np.ones(grid.points)
    mean = target[1:4] / target[0]
    x = [axis - m for axis, m in zip(nodes(grid), mean)]
    basis = np.array([one, *(one * x[a] for a in range(d)), one * sum(a * a for a in x[:d])])
    spread = 2.0 * target[4] - target[0] * mean @ mean
    thermal = np.sqrt(spread / target[0])
    wanted = np.array([target[0], *np.zeros(d), spread])
    unit = np.array([target[0], *[target[0] * thermal] * d, spread])
    theta, mismatch = np.zeros(d + 2), []
    for _ in range(steps):
        values = g * np.exp(np.einsum("p,pijk->ijk", theta, basis))
        lack = wanted - np.einsum("ijk,pijk->p", values, basis)
        mismatch.append(np.max(np.abs(lack) / unit))
        step = np.linalg.solve(np.einsum("ijk,pijk,qijk->pq", values, basis, basis), lack)
        reach = np.abs(step) @ np.array([1.0, *[3.0 * thermal] * d, 9.0 * thermal**2])
        theta = theta + step * min(1.0, 2.0 / reach)
    return mismatch


@pytest.mark.parametrize(
    ("points", "before", "after", "speed"),
    [((16,), 0.3, 0.3, 2.0), ((12, 10), 0.3, 0.3, 2.0), ((12, 10), 1.5, 0.3, 3.0), ((8, 8, 8), 4.0, 1.0, 3.0)],
)
def test_steps_that_go_too_far_are_halved(points, before, after, speed):
    """Three times the gas, far away and of another temperature: full steps make the mismatch larger on the way."""
    grid, d = make_grid(points, 5.0), len(points)
    g = np.exp(-0.5 * sum(axis**2 for axis in nodes(grid)) / before)
    g /= g.sum()
    target = 3.0 * np.array([1.0, speed, 0.0, 0.0, 0.5 * (d * after + speed**2)])
    full = np.array(plain_newton(grid, g, target, 12))
    assert np.any(full[1:] > (1.0 + 1e-6) * full[:-1]) and full[-1] > 1e-11
    answer, factor, _sums = run_correct(grid, g, target)
    assert answer == pytest.approx(full[0], rel=1e-12)
    assert np.all(np.abs(five(grid, g * factor) - target) <= 1e-12 * 2 * target[4])
    np.testing.assert_allclose(factor, corrected(grid, g, target) / g, rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("mass below zero", [-1.0, 0, 0, 0, 1.0]),
        ("no mass", [0.0, 0, 0, 0, 1.0]),
        ("energy below that of the flow", [1.0, 2.0, 0, 0, 1.9]),
        ("a mean outside the box", [1.0, 9.0, 0, 0, 42.0]),
        ("colder than two nodes", [1.0, 0, 0, 0, 0.01]),
        ("hotter than the box", [1.0, 0, 0, 0, 60.0]),
        ("not a number", [np.nan, 0, 0, 0, 1.0]),
        ("an energy that is not a number", [1.0, 0, 0, 0, np.nan]),
    ],
)
@pytest.mark.parametrize("points", [(8,), (8, 6), (8, 6, 6)])
def test_impossible_targets_are_refused(points, name, target):
    grid = make_grid(points, 5.0)
    g = gas(grid, np.random.default_rng(0))
    answer, _factor, _sums = run_correct(grid, g / g.sum(), np.array(target))
    assert answer == -1.0


def test_a_g_that_is_not_positive_on_the_whole_is_refused():
    grid = make_grid((8, 6, 6))
    g = gas(grid, np.random.default_rng(0))
    for bad in (-g, 0.0 * g, np.nan * g):
        assert run_correct(grid, bad, five(grid, g))[0] == -1.0


@SETTINGS
@given(points=POINTS, seed=SEED)
def test_add_correction(points, seed):
    """A block of any sign gets the moments wanted, by the polynomial times the Gaussian of a linear system."""
    grid, rng = make_grid(points), np.random.default_rng(seed)
    kernel, d = kernel_grid(grid), len(points)
    work = Correction.ones(kernel)
    near, signed = random_g(grid, rng), random_g(grid, rng, signed=True)
    block = near + 0.1 * near.max() * signed / np.abs(signed).max()
    target = five(grid, random_g(grid, rng))
    mean = target[1:4] / target[0]
    assume(2.0 * target[4] > 1.01 * target[0] * (mean**2).sum())
    packed, sums = pack(grid, block), np.empty(SUMS)
    mismatch = add_correction(packed, pack(grid, near), target, kernel, work, sums)
    found = grid.unpack(packed)
    c = [axis - m for axis, m in zip(nodes(grid), mean)]
    one = np.ones(grid.points)
    basis = np.array([one, *(one * c[a] for a in range(d)), one * sum(c[a] ** 2 for a in range(d))])
    spread = 2.0 * target[4] - target[0] * (mean**2).sum()
    missing = np.array([target[0], *np.zeros(d), spread]) - np.einsum("pijk,ijk->p", basis, block)
    matrix = np.einsum("pijk,qijk,ijk->pq", basis, basis, near)
    wanted = block + near * np.einsum("p,pijk->ijk", np.linalg.solve(matrix, missing), basis)
    scale = np.abs(wanted).max() * np.linalg.cond(matrix)
    np.testing.assert_allclose(found, wanted, atol=1e-14 * scale)
    np.testing.assert_allclose(five(grid, found), target, atol=1e-11 * np.abs(wanted).sum() * 50)
    np.testing.assert_allclose(sums[:10], ten_sums(grid, found), atol=1e-13 * np.abs(wanted).sum() * 100)
    assert mismatch > 0.0
