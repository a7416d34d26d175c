"""The vector of eight doubles: every operation lane by lane against NumPy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rvm_mpi.compiling import simd
from rvm_mpi.compiling.declare import kernel
from rvm_mpi.grid.domain import aligned
from rvm_mpi.grid.velocity import LEAST
from rvm_mpi.kinetic import limiter
from rvm_mpi.reference.state import half_slope

SETTINGS = settings(max_examples=80, deadline=None)
ROWS = 33


@kernel
def operate(a, b, c, d, e, f, out, number):
    """Every operation on the vectors a .. f and a number, one result a row."""
    va, vb, vc = simd.load(a, 0), simd.load(b, 0), simd.load(c, 0)
    vd, ve, vf = simd.load(d, 0), simd.load(e, 0), simd.load(f, 0)
    simd.store(out, 0, va + vb)
    simd.store(out, 8, va - vb)
    simd.store(out, 16, va * vb)
    simd.store(out, 24, va + number)
    simd.store(out, 32, number - va)
    simd.store(out, 40, va * number)
    simd.store(out, 48, simd.minimum(va, vb))
    simd.store(out, 56, simd.maximum(va, vb))
    simd.store(out, 72, simd.shifted(va, vb))
    least = simd.splat(LEAST)
    one, two, three = limiter.van_leer3((va, vb, least), (vc, vd, least), (ve, vf, least))
    simd.store(out, 88, one)
    simd.store(out, 96, two)
    simd.store(out, 104, three)
    simd.store(out, 112, simd.upwind(va, vb, vc))
    simd.store(out, 120, simd.where_positive(va, vb, vc))
    simd.store(out, 128, simd.exponential(va))
    simd.store(out, 136, simd.splat(number))
    out[144] = simd.total(va)
    even, odd = simd.apart(va, vb)
    low, high = simd.together(va, vb)
    simd.store(out, 152, even)
    simd.store(out, 160, odd)
    simd.store(out, 168, low)
    simd.store(out, 176, high)
    one, two, three = limiter.van_leer3(
        (va, vb, least), (vc, vd, simd.splat(number)), (ve, vf, simd.splat(math.inf))
    )
    simd.store(out, 192, two)
    simd.store(out, 200, three)
    simd.store(out, 208, simd.spread(a, 3))
    simd.store(out, 216, simd.leading(va, int(number)))
    out[145] = simd.first_lane(vb)
    simd.store(out, 224, va / vb)
    simd.store(out, 232, va / number)
    simd.store(out, 240, number / va)
    simd.store(out, 248, abs(va))
    simd.store(out, 256, math.sqrt(va))
    simd.prefetch(a, 0)
    simd.prefetch(a, 10**6)


def results(vectors, number=0.5):
    out = aligned((ROWS * 8,))
    operate(*(np.asarray(v, dtype=float) for v in vectors), out, float(number))
    return out.reshape(ROWS, 8)


@kernel
def move(source, places, target, others):
    simd.distribute(target, 3, others, simd.collect(source, 2, places))


def test_elements_from_and_to_anywhere():
    """Places count from the first element of a view, whatever its strides; only the eight are written."""
    rng = np.random.default_rng(4)
    source, target = rng.random((4, 5, 6)), np.full(40, -1.0)
    places, others = rng.permutation(60)[:8], rng.permutation(30)[:8]
    move(source[1:, ::2], places, target[5:], others)
    expected = np.full(40, -1.0)
    expected[5 + 3 + others] = source.ravel()[30 + 2 + places]
    assert np.array_equal(target, expected)


def sizes(largest):
    """Numbers of both signs from 10^-largest to 10^largest, and zero."""
    magnitude = st.floats(-largest, largest).map(lambda p: 10.0**p)
    return st.one_of(st.just(0.0), magnitude, magnitude.map(lambda x: -x))


def vectors(elements, count):
    return st.lists(st.lists(elements, min_size=8, max_size=8).map(np.array), min_size=count, max_size=count)


@SETTINGS
@given(v=vectors(sizes(30), 6), number=sizes(30))
def test_arithmetic(v, number):
    a, b, c = v[:3]
    out = results(v, number)
    assert np.array_equal(out[0], a + b)
    assert np.array_equal(out[1], a - b)
    assert np.array_equal(out[2], a * b)
    assert np.array_equal(out[3], a + number)
    assert np.array_equal(out[4], number - a)
    assert np.array_equal(out[5], a * number)
    assert np.array_equal(out[6], np.minimum(a, b))
    assert np.array_equal(out[7], np.maximum(a, b))
    assert np.array_equal(out[9], [a[7], *b[:7]])
    assert np.array_equal(out[19:21].ravel(), [*a[::2], *b[::2], *a[1::2], *b[1::2]])
    assert np.array_equal(out[21:23].ravel(), np.column_stack((a, b)).ravel())
    assert np.array_equal(out[14], a * np.where(a > 0, b, c))
    assert np.array_equal(out[15], np.where(a > 0, b, c))
    assert np.array_equal(out[17], np.full(8, number))
    in_order = 0.0
    for lane in a:
        in_order += lane
    assert out[18, 0] == in_order


@SETTINGS
@given(v=vectors(sizes(30), 6), number=sizes(30))
def test_division_and_roots(v, number):
    a, b = v[:2]
    out = results(v, number)
    with np.errstate(all="ignore"):
        assert np.array_equal(out[28], a / b, equal_nan=True)
        assert np.array_equal(out[29], a / number, equal_nan=True)
        assert np.array_equal(out[30], number / a, equal_nan=True)
        assert np.array_equal(out[32], np.sqrt(a), equal_nan=True)
    assert np.array_equal(out[31], np.abs(a))


@SETTINGS
@given(v=vectors(sizes(60), 6))
def test_limited_slopes(v):
    out = results(v)
    wanted = [half_slope(v[2 * i], v[2 * i + 1]) for i in range(3)]
    # the shared divisions leave out slopes of differences whose product is below 1e-180
    shared = [np.where(v[2 * i] * v[2 * i + 1] > 1e-180, wanted[i], 0.0) for i in range(3)]
    for row, expected in enumerate(shared, start=11):
        np.testing.assert_allclose(out[row], expected, rtol=2e-15)


@SETTINGS
@given(v=vectors(sizes(60), 6), least=sizes(60).map(abs))
def test_slopes_above_a_threshold(v, least):
    out = results(v, least)
    product = v[2] * v[3]
    slope = np.where(product > 1e-180, half_slope(v[2], v[3]), 0.0)
    np.testing.assert_allclose(out[24], np.where(product > least, slope, 0.0), rtol=2e-15)
    assert not out[25].any()


@settings(max_examples=20, deadline=None)
@given(v=vectors(sizes(30), 6), count=st.integers(-1, 9))
def test_lanes(v, count):
    out = results(v, count)
    np.testing.assert_array_equal(out[26], np.full(8, v[0][3]))
    np.testing.assert_array_equal(out[27], np.where(np.arange(8) < count, v[0], 0.0))
    assert out[18, 1] == v[1][0]


def test_slopes_of_extremes_and_plateaus_are_zero():
    zero, up, down = np.zeros(8), np.full(8, 2.0), np.full(8, -3.0)
    for a, b in ((zero, zero), (zero, up), (up, zero), (up, down), (down, up)):
        out = results([a, b, a, b, a, b])
        assert not out[[11, 12, 13]].any()


@SETTINGS
@given(v=vectors(st.floats(-705.0, 705.0), 6))
def test_exponential(v):
    wanted = np.array([math.exp(x) for x in v[0]])
    np.testing.assert_allclose(results(v)[16], wanted, rtol=2e-14)


@pytest.mark.parametrize("sample", [np.linspace(-1.0, 1.0, 8000), np.linspace(-708.0, 708.0, 8000)])
def test_exponential_throughout(sample):
    rest = [np.ones(8)] * 5
    out = np.concatenate([results([part, *rest])[16] for part in sample.reshape(-1, 8)])
    np.testing.assert_allclose(out, np.exp(sample), rtol=2e-14)


def test_exponential_at_the_ends():
    x = np.array([0.0, -0.0, -708.0, -709.0, -1e4, 709.0, 710.0, 1e4])
    out = results([x, *[np.ones(8)] * 5])[16]
    assert out[0] == out[1] == 1.0
    assert out[2] == out[3] == out[4] > 0.0
    assert out[5] == out[6] == out[7] < math.inf
    # not a number is clamped like the lowest: whoever uses the result must look at the argument
    assert results([np.full(8, math.nan), *[np.ones(8)] * 5])[16, 0] == out[2]
