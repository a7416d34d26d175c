"""Comparing quantities: against a plain loop over the numbers, whatever the numbers."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from rvm_mpi.output import differences
from rvm_mpi.output.compare import _pairs
from rvm_mpi.output.differences import Columns, Found, Picked, Quantity

NUMBERS = st.one_of(
    st.sampled_from([0.0, -0.0, 1.0, math.nan, math.inf, -math.inf, 1e-320]), st.floats(allow_subnormal=True)
)


@st.composite
def pairs(draw):
    """Two arrays of one shape that have most of their numbers in common, as results that differ have."""
    shape = draw(array_shapes(min_dims=1, max_dims=3, max_side=4))
    one = draw(arrays(np.float64, shape, elements=NUMBERS))
    other = one.copy()
    for _ in range(draw(st.integers(0, 3))):
        other[tuple(draw(st.integers(0, n - 1)) for n in shape)] = draw(NUMBERS)
    return one, other


def by_hand(one, other, allowed):
    """Index of the first number that differs, the largest difference: number by number; `allowed` None: the bits."""
    first, largest = None, 0.0
    for index in np.ndindex(one.shape):
        a, b = float(one[index]), float(other[index])
        same = struct.pack("d", a) == struct.pack("d", b) or (math.isnan(a) and math.isnan(b))
        distance = 0.0 if same else abs(a - b)
        distance = math.inf if math.isnan(distance) else distance
        if first is None and (not same if allowed is None else distance > allowed):
            first = index
        largest = max(largest, distance)
    return first, largest


@pytest.mark.parametrize("piece", [1, 5, 2**22])
@given(pair=pairs(), tolerance=st.one_of(st.none(), st.floats(0.0, 2.0)), size=st.floats(0.0, 10.0))
def test_against_a_loop_over_the_numbers(piece, pair, tolerance, size):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(differences, "PIECE", piece)
        axes = ("a", "b", "c")[: pair[0].ndim]
        found = differences.compare(*(Quantity(axes, values) for values in pair), size, tolerance)
    first, largest = by_hand(*pair, None if tolerance is None else tolerance * size)
    if first is None:
        assert found is None
        return
    assert found.first == first
    assert found.largest == largest
    assert struct.pack("dd", *found.values) == struct.pack("dd", *(float(values[first]) for values in pair))
    worst = abs(pair[0][found.worst] - pair[1][found.worst])
    assert worst == largest or not np.isfinite(worst)


@given(values=arrays(np.float64, array_shapes(max_dims=3, max_side=4), elements=NUMBERS))
def test_everything_equals_itself(values):
    axes = ("a", "b", "c")[: values.ndim]
    assert differences.compare(Quantity(axes, values), Quantity(axes, values.copy()), 1.0) is None
    assert differences.compare(Quantity(axes, values), Quantity(axes, values.copy()), 1.0, 0.0) is None


def test_snapshots_are_paired_by_their_times():
    nan = np.nan
    a, b = np.array([0.0, 0.1, nan, 0.3, 0.5]), np.array([0.0, 0.2, 0.3, nan, nan])
    assert _pairs(a, b, 0.0) == ([(0, 0), (3, 2)], [(0, 1), (1, 1), (0, 4)])
    assert _pairs(a, b + 1e-9, 0.0)[0] == []
    assert _pairs(a, b + 1e-9, 1e-8)[0] == [(0, 0), (3, 2)]
    one = Quantity(("time", "x"), Picked(np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]), (0, 2)))
    other = Quantity(("time", "x"), Picked(np.array([[1.0, 2.0], [5.0, 6.5]]), (0, 1)))
    assert one.shape == (2, 2)
    assert one.largest() == 6.0
    assert differences.compare(one, other, 1.0) == Found((1, 1), (6.0, 6.5), 0.5, 0.5, (1, 1))


def test_units_of_what_is_nought_but_for_rounding():
    def quantity(value):
        return Quantity(("step",), np.array([value]))

    one = {"mass": 4.0, "energy": 9.0, "momentum_x": 1e-16, "energy_error": 2e-16, "min_g": 1e-20, "max_g": 0.5}
    size = differences.sizes({n: quantity(v) for n, v in one.items()}, {n: quantity(-v) for n, v in one.items()})
    assert size == {"mass": 4.0, "energy": 9.0, "momentum_x": 6.0, "energy_error": 1.0, "min_g": 0.5, "max_g": 0.5}
    fields = {"kinetic/temperature": 4.0, "kinetic/density": 2.0, "kinetic/velocity": 0.0, "kinetic/heat_flux": 1e-17}
    size = differences.sizes(*({n: quantity(v) for n, v in fields.items()} for _ in range(2)))
    assert size["kinetic/velocity"] == 2.0 and size["kinetic/heat_flux"] == 16.0


def test_columns_of_the_small_fields():
    packed = np.arange(24.0).reshape(2, 3, 4)
    part = Columns(packed, 1, 3)
    assert part.shape == (2, 3, 2)
    np.testing.assert_array_equal(part[1:2], packed[1:2, :, 1:3])
