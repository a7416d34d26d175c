"""The Boltzmann operator's weights against their defining integral, its sum against plain loops, its symmetries."""

from functools import cache
from math import pi

import numpy as np
import pytest

from rvm_mpi import Job, Simulation
from rvm_mpi.collisions.boltzmann import BoltzmannOperator, Modes, scatter
from rvm_mpi.collisions.weights import (
    SUPPORT,
    RadialIntegral,
    Rows,
    kernel_scale,
    pair_weights,
    sphere_mean,
)

GRIDS = [(8,), (13,), (6, 8), (6, 4, 8)]


@cache
def operator(points, restitution=0.3, exponent=0.5):
    return BoltzmannOperator.create(points, 5.0, restitution, exponent, 0.7)


def collide(op, g):
    out = np.full_like(g, np.nan)
    op.collide(g, out)
    return out


def random_cells(cells, points, seed=1):
    return np.random.default_rng(seed).random((cells, *points))


# ---- weights


def sphere_rule(d, count):
    """Unit vectors and weights for the integral over the sphere."""
    if d == 1:
        return np.array([[1.0], [-1.0]]), np.ones(2)
    angle = 2 * pi * np.arange(2 * count) / (2 * count)
    ring = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    if d == 2:
        return ring, np.full(2 * count, pi / count)
    c, w = np.polynomial.legendre.leggauss(count)
    vectors = np.concatenate([np.column_stack((np.sqrt(1 - z * z) * ring, np.full(2 * count, z))) for z in c])
    return vectors, np.repeat(w, 2 * count) * pi / count


def defining_integral(l, m, half_width, e, exponent, b):  # noqa: E741
    """int b |u|^lambda exp(-i pi/V m . u) (exp(-i pi/V k . (v' - v)) - 1) du dsigma over |u| <= 2 R, by brute force."""
    l, m = np.array(l), np.array(m)  # noqa: E741
    d, wave, reach = l.size, pi / half_width, 2 * SUPPORT * half_width
    directions, areas = sphere_rule(d, 20 if d == 2 else 14)
    x, w = np.polynomial.legendre.leggauss(48)
    total = 0.0
    # |u| = reach s^4 smooths |u|^lambda
    for s, weight in zip(0.5 * (x + 1), 0.5 * w):
        speed = reach * s**4
        u, sigma = speed * directions[:, None], directions[None, :]
        v = np.zeros(d)  # v_* = v - u
        after = (v + v - u) / 2 + (1 - e) / 4 * u + (1 + e) / 4 * speed * sigma
        plane = np.exp(-1j * wave * (u @ m)) * (np.exp(-1j * wave * (after @ (l + m))) - 1)
        measure = weight * 4 * reach * s**3 * speed ** (d - 1 + exponent) * b
        total += measure * np.einsum("u,s,us->", areas, areas, plane)
    return total


@pytest.mark.parametrize("e, exponent", [(1.0, 1.0), (0.3, 0.5), (0.0, 0.0)])
@pytest.mark.parametrize(
    "l, m",
    [
        ((2,), (1,)),
        ((3,), (-3,)),
        ((0,), (3,)),
        ((1, 0), (2, 3)),
        ((2, -1), (2, -1)),
        ((3, 1), (-3, 0)),
        ((1, 0, 2), (1, -2, 1)),
        ((0, 0, 0), (2, 1, 1)),
    ],
)
def test_weights_are_the_defining_integral(l, m, e, exponent):  # noqa: E741
    half_width, b = 3.0, 0.7
    expected = defining_integral(l, m, half_width, e, exponent, b)
    expected += defining_integral(m, l, half_width, e, exponent, b)
    integral = RadialIntegral.create(len(l), exponent, 5.0)
    squares = (np.array([np.dot(a, a)]) for a in (np.add(l, m), l, m))
    factor = kernel_scale(len(l), half_width, exponent, b)
    found = factor * pair_weights(integral, e, *squares)[0]
    scale = factor * integral.weights.sum()
    assert abs(expected.imag) < 1e-12 * scale
    assert found == pytest.approx(expected.real, abs=1e-12 * scale)


@pytest.mark.parametrize("d", [1, 3])
def test_radial_integral_in_closed_form(d):
    """int cos cos ds and int s^2 sinc sinc ds, to arguments of 64 points a direction."""
    integral = RadialIntegral.create(d, 0.0, 31.0)
    p, q = np.linspace(0.1, 31, 200), 7.3
    difference, total = (np.sinc(integral.wave * a / pi) for a in (p - q, p + q))
    expected = (difference + total) / 2 if d == 1 else (difference - total) / (2 * integral.wave**2 * p * q)
    scale = integral.weights.sum()
    found = integral.evaluate(integral.rows(np.array([q]))[:, 0], p * p)
    assert np.abs(found / scale - d * expected).max() < 5e-14


def test_bytes_are_known_beforehand():
    for points in GRIDS:
        op = operator(points)
        assert Rows.create(points).weight_bytes == op.weights.nbytes
        assert op.weights.nbytes < op.nbytes < op.weights.nbytes + 64 * (op.rows.pairs.shape[0] + 1)
    assert Rows.create((64, 64)).weight_bytes < 1e7
    assert Rows.create((24,) * 3).weight_bytes < 2e7


def test_every_pair_is_visited_once():
    """The products counted are the pairs {l, m} whose k is in the upper half."""
    for points in GRIDS:
        largest = [(n - 1) // 2 for n in points]
        modes = np.stack(np.meshgrid(*[np.arange(-m, m + 1) for m in largest], indexing="ij"), axis=-1)
        modes = modes.reshape(-1, len(points))
        total = modes[:, None] + modes[None, :]
        kept = (np.abs(total) <= largest).all(axis=2)
        upper = np.zeros_like(kept)
        for axis in reversed(range(len(points))):
            upper = (total[..., axis] > 0) | ((total[..., axis] == 0) & upper)
        ordered = np.triu(np.ones_like(kept))
        exact = int((kept & upper & ordered).sum())
        # k = (row of zero, 0) is skipped, k = (any other row, 0) is not
        assert Rows.create(points).products == exact


# ---- in a stage


def test_a_stage_takes_the_operator_and_its_loss_of_energy():
    """omega^lambda/eps Q in the block's layout, and f's energy by plain sums over the nodes, about each cell's mean."""
    e, eps, exponent = 0.8, 0.1, 1.0
    job = {
        "space": {"cells": [5, 4]},
        "velocity": {"points": [12, 11, 10], "half_width": 6.5},
        "collision": {"operator": "boltzmann", "knudsen": eps, "restitution": e},
        "initial": {
            "state": "wave", "velocity": [0.4, -0.3, 0.2], "density_amplitude": 0.4, "temperature_amplitude": 0.3,
        },
        "time": {"end": 1.0},
    }  # fmt: skip
    kinetic = Simulation(Job.from_dict(job, name="stage")).kinetic
    grid, omega = kinetic.velocity_grid, kinetic.omega
    operator = kinetic._operator
    operator.collide(kinetic, kinetic.g, kinetic.now)
    g = grid.unpack(kinetic.inside(kinetic.g))
    q = np.empty((20, 12, 11, 10))
    operator._operator.collide(g.reshape(q.shape), q)
    q = q.reshape(g.shape) * (omega**exponent / eps)[..., None, None, None]
    np.testing.assert_allclose(grid.unpack(operator.source), q, rtol=1e-13, atol=1e-14 * np.abs(q).max())
    axes = (np.arange(n) * 2 + 1 - n for n in (12, 11, 10))
    xi = np.stack(np.meshgrid(*(a * 6.5 / len(a) for a in axes), indexing="ij"), axis=-1)
    mean = np.einsum("yxabc,abcd->yxd", g, xi) / g.sum(axis=(2, 3, 4))[..., None]
    square = ((xi - mean[:, :, None, None, None]) ** 2).sum(axis=-1)
    expected = 0.5 * grid.weight * omega**2 * (square * q).sum(axis=(2, 3, 4))
    assert (expected < 0).all() and np.ptp(expected) > 0.1 * np.abs(expected).max()
    np.testing.assert_allclose(operator.heating, expected, rtol=1e-12)


# ---- the sum


def plain_sum(g, op):
    """Q(g, g) by two loops over the modes, each weight by quadrature, nothing symmetrised."""
    d, z = g.ndim, (1 + op.restitution) / 4
    f = np.fft.fftn(g) / g.size
    q = np.zeros_like(f)
    largest = np.array([(n - 1) // 2 for n in g.shape])
    rule = RadialIntegral.create(d, op.exponent, 2 * np.linalg.norm(largest))
    scale = kernel_scale(d, op.half_width, op.exponent, op.cross_section)

    @cache
    def integral(p, r):
        product = sphere_mean(d, rule.wave * p * rule.nodes) * sphere_mean(d, rule.wave * r * rule.nodes)
        return scale * float(rule.weights @ product)

    modes = [np.array(n) - largest for n in np.ndindex(*(2 * largest + 1))]
    for l in modes:  # noqa: E741
        for m in modes:
            k = l + m
            if (np.abs(k) <= largest).all():
                weight = integral(np.linalg.norm(m - z * k), z * np.linalg.norm(k)) - integral(np.linalg.norm(m), 0.0)
                q[tuple(k)] += weight * f[tuple(l)] * f[tuple(m)]
    return np.fft.ifftn(q) * g.size


@pytest.mark.parametrize("points, e, exponent", [*((p, 0.3, 0.5) for p in GRIDS), ((6, 8), 1.0, 1.0), ((8,), 0.0, 0.0)])
def test_sum_against_plain_loops(points, e, exponent):
    op = operator(points, e, exponent)
    g = random_cells(3, points)
    found, expected = collide(op, g)[2], plain_sum(g[2], op)
    assert np.abs(expected.imag).max() < 1e-13 * np.abs(expected).max()
    assert np.abs(found - expected).max() < 1e-13 * np.abs(expected).max()


def test_elastic_line_does_nothing():
    """In one dimension elastic particles exchange velocities or pass."""
    op = operator((16,), 1.0, 1.0)
    rates = np.abs(operator((16,), 0.0, 1.0).weights).max()
    assert np.abs(op.weights).max() < 1e-13 * rates
    assert np.abs(collide(op, random_cells(2, (16,)))).max() < 1e-13 * rates * kernel_scale(1, 5.0, 1.0, 0.7)


@pytest.mark.parametrize("points", GRIDS)
def test_mass_is_exact(points):
    """The spectrum of Q has a zero at k = 0, whatever the sum holds there."""
    q = collide(operator(points), random_cells(9, points))
    axes = tuple(range(1, q.ndim))
    assert (np.abs(q.sum(axis=axes)) < 1e-15 * np.abs(q).sum(axis=axes)).all()
    nx, ny, nz = shape = (1,) * (3 - len(points)) + points
    highest = tuple((n - 1) // 2 for n in shape)
    modes = Modes(*np.random.default_rng(3).random((2, np.prod([2 * m + 1 for m in highest]) * 8)))
    spectrum = np.full(nx * ny * (nz // 2 + 1) * 16, np.nan)
    scatter(modes, shape, highest, spectrum, 0)
    assert (spectrum[:16] == 0).all() and np.isfinite(spectrum).all()


@pytest.mark.parametrize("points", GRIDS)
def test_translations_and_reflections(points):
    op = operator(points)
    g = random_cells(2, points)
    q = collide(op, g)
    scale = 1e-13 * np.abs(q).max()
    for axis in range(1, g.ndim):
        assert np.abs(collide(op, np.roll(g, 2, axis)) - np.roll(q, 2, axis)).max() < scale
        assert np.abs(collide(op, np.flip(g, axis)) - np.flip(q, axis)).max() < scale


def test_axes_are_alike():
    op = operator((6, 6, 6))
    g = random_cells(2, (6, 6, 6))
    q = collide(op, g)
    for order in ((0, 2, 1, 3), (0, 3, 1, 2)):
        turned = collide(op, np.ascontiguousarray(g.transpose(order)))
        assert np.abs(turned - q.transpose(order)).max() < 1e-13 * np.abs(q).max()


@pytest.mark.parametrize(
    "points, cells", [((8,), 2100), ((64,), 300), ((12, 14), 117), ((15, 24), 61), ((6, 4, 10), 85)]
)
def test_a_cells_place_changes_no_bit(points, cells):
    op = operator(points)
    g = random_cells(cells, points)
    q = collide(op, g)
    order = np.random.default_rng(2).permutation(cells)
    assert np.array_equal(collide(op, g[order]), q[order])
    for cell in (0, 7, 8, cells - 1):
        assert np.array_equal(collide(op, g[cell : cell + 1])[0], q[cell])


def test_strided_cells_and_in_place():
    op = operator((6, 8))
    g = random_cells(20, (6, 8))
    q = collide(op, g)
    wide = np.zeros((20, 6, 11))
    wide[..., :8] = g
    out = np.zeros((20, 6, 9))
    op.collide(wide[..., :8], out[..., :8])
    assert np.array_equal(out[..., :8], q) and not out[..., 8].any()
    op.collide(g, g)
    assert np.array_equal(g, q)


def test_cells_of_the_plane_times_a_factor():
    """Views of blocks that are padded on every side, as a stage has them, in one dimension with a gap at each node."""
    for points, gap in (((11,), 8), ((6, 9), 1), ((4, 5, 6), 1)):
        op = operator(points)
        g = random_cells(4 * 5, points).reshape(4, 5, *points)
        factor = np.random.default_rng(5).random((4, 5))
        wide, out = (np.full((8, 9, *points[:-1], points[-1] + 3, gap), fill) for fill in (np.nan, -1.0))
        inner = (slice(2, 6), slice(2, 7), *(slice(None),) * (len(points) - 1), slice(points[-1]), 0)
        wide[inner] = g
        op.collide(wide[inner], out[inner], factor)
        q = collide(op, g.reshape(20, *points)).reshape(g.shape)
        expected = q * factor.reshape(4, 5, *(1,) * len(points))
        np.testing.assert_allclose(out[inner], expected, rtol=1e-15, atol=0)
        out[inner] = -1.0
        assert (out == -1.0).all()


def test_weights_serve_any_box_and_cross_section():
    """Q scales as b V^(d + lambda) at the same nodes over V; test_sum_against_plain_loops has the constant."""
    op = operator((6, 8))
    assert not op.weights.flags.writeable
    other = BoltzmannOperator.create((6, 8), 7.0, 0.3, 0.5, 2.1, weights=op.weights)
    g = random_cells(3, (6, 8))
    factor = 3 * 1.4**2.5
    np.testing.assert_allclose(collide(other, g), factor * collide(op, g), rtol=1e-13, atol=0)
    with pytest.raises(ValueError, match="weights"):
        BoltzmannOperator.create((6, 10), 5.0, weights=op.weights)


@pytest.mark.parametrize(
    "points, keys",
    [((2, 8), {}), ((), {}), ((8,) * 4, {}), ((8,), {"restitution": 1.1}), ((8,), {"exponent": -0.1})],
)
def test_what_is_refused(points, keys):
    with pytest.raises(ValueError, match=r"points|restitution"):
        BoltzmannOperator.create(points, 5.0, **keys)


def test_shapes_are_checked():
    op = operator((8,))
    for g, factor in (((2, 9), (2,)), ((8,), ()), ((2, 2, 2, 8), (2, 2, 2)), ((2, 8), (3,))):
        with pytest.raises(ValueError, match="wanted"):
            op.collide(np.zeros(g), np.zeros(g), np.ones(factor))
    with pytest.raises(ValueError, match="wanted"):
        op.collide(np.zeros((2, 8)), np.zeros((3, 8)))
    for kinds in ((np.float32, np.float64), (np.float64, np.float32), (np.int64, np.float64)):
        with pytest.raises(ValueError, match="wanted float64"):
            op.collide(*(np.zeros((2, 8), dtype=kind) for kind in kinds))
