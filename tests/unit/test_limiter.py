"""The value on a face that transport in x takes: its bounds, its order, and its three forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rvm_mpi.compiling import simd
from rvm_mpi.compiling.declare import kernel
from rvm_mpi.grid.domain import aligned
from rvm_mpi.kinetic import limiter
from rvm_mpi.reference import state

SETTINGS = settings(max_examples=200, deadline=None)
POSITIVE = st.one_of(st.just(0.0), st.floats(-30, 30).map(lambda p: 10.0**p))
EITHER = st.floats(-1e30, 1e30)


def eights(elements):
    return st.lists(st.tuples(*(elements,) * 3), min_size=8, max_size=8).map(lambda rows: np.array(rows).T)


@kernel
def faces(u, a, b, out):
    simd.store(out, 0, limiter.face_value(simd.load(u, 0), simd.load(a, 0), simd.load(b, 0)))
    for lane in range(8):
        out[8 + lane] = limiter.face_number(u[lane], a[lane], b[lane], limiter.ROOM)


def on_face(behind, u, ahead):
    """The vector's values, the numbers' and the reference's."""
    a, b, out = u - behind, ahead - u, aligned((16,))
    faces(u.copy(), a, b, out)
    return out[:8].copy(), out[8:].copy(), state.face_value(u, a, b)


@SETTINGS
@given(cells=eights(EITHER))
def test_vectors_numbers_and_the_reference_agree(cells):
    vectors, numbers, reference = on_face(*cells)
    assert np.array_equal(vectors, numbers)
    np.testing.assert_allclose(vectors, reference, rtol=0, atol=1e-15 * np.abs(cells).max(axis=0).max())


@SETTINGS
@given(cells=eights(POSITIVE))
def test_no_cell_can_lose_more_than_it_has(cells):
    """At a Courant number of one half in all directions together: no face's value above twice the upwind one."""
    value = on_face(*cells)[0]
    assert np.all(value >= 0.0)
    assert np.all(value <= 2.0 * cells[1] * (1.0 + 4e-16))


@SETTINGS
@given(cells=eights(POSITIVE))
def test_between_neighbours_but_for_the_room(cells):
    behind, u, ahead = cells
    value, room = on_face(*cells)[0], limiter.ROOM * u * (1.0 + 1e-13)
    rounding = 4e-16 * cells.max(axis=0)
    assert np.all(value <= np.maximum(u, ahead) + room + rounding)
    assert np.all(value >= np.minimum(u, ahead) - room - rounding)
    rising = np.minimum(u - behind, ahead - u) > 0.0
    falling = np.maximum(u - behind, ahead - u) < 0.0
    assert np.all(np.abs(value - u)[~rising & ~falling] <= room[~rising & ~falling])


@pytest.mark.parametrize("top", [-2.0, 0.3, 5.0])
def test_parabolas_are_met_exactly(top):
    """Third order, at an extremum too: cells hold means of a parabola whose curvature is small beside it."""
    edges = np.arange(-1.5, 2.0)
    means = np.diff(20.0 * edges - 0.05 * (edges - top) ** 3 / 3.0)
    cells = np.repeat(means[:, None], 8, axis=1)
    np.testing.assert_allclose(on_face(*cells)[0], 20.0 - 0.05 * (0.5 - top) ** 2, rtol=1e-14)


def test_equal_cells_are_kept_to_the_last_bit():
    u = np.random.default_rng(1).normal(size=8)
    assert all(np.array_equal(found, u) for found in on_face(u, u, u))
