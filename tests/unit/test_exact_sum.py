"""Order-independent exact sums against math.fsum and exact fractions."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rvm_mpi.exact_sum import exact_sums

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
# below 1e300 math.fsum's own partial sums cannot overflow
moderate = st.floats(min_value=-1e300, max_value=1e300)


class TwoRanks:
    """Stands in for a communicator of two ranks: adds the other rank's limbs, recorded before."""

    size = 2

    def __init__(self, other=None):
        self.other = other

    def Allreduce(self, mine, total):
        total[...] = mine if self.other is None else mine + self.other
        self.seen = mine.copy()


def same_bits(a, b):
    return np.float64(a).tobytes() == np.float64(b).tobytes()


@settings(max_examples=300, deadline=None)
@given(st.lists(moderate, max_size=40))
def test_equals_fsum(values):
    assert exact_sums([np.array(values, dtype=float)])[0] == math.fsum(values)


@settings(max_examples=200, deadline=None)
@given(st.lists(finite, min_size=1, max_size=20))
def test_equals_the_exact_fraction_over_the_whole_range(values):
    exact = sum(map(Fraction, values), Fraction(0))
    try:
        expected = exact.numerator / exact.denominator
    except OverflowError:
        expected = math.inf if exact > 0 else -math.inf
    assert exact_sums([np.array(values)])[0] == expected


@settings(max_examples=200, deadline=None)
@given(st.lists(finite, min_size=2, max_size=30), st.randoms(use_true_random=False), st.data())
def test_order_and_split_do_not_matter(values, random, data):
    whole = exact_sums([np.array(values)])[0]
    shuffled = list(values)
    random.shuffle(shuffled)
    assert same_bits(exact_sums([np.array(shuffled)])[0], whole)
    cut = data.draw(st.integers(0, len(values)))
    first = TwoRanks()
    exact_sums([np.array(shuffled[:cut])], first)
    assert same_bits(exact_sums([np.array(shuffled[cut:])], TwoRanks(first.seen))[0], whole)


def test_cancellation_that_plain_summation_loses():
    values = np.array([1e16, 1.0, -1e16, 1e-300, 1.0, -1e-300])
    assert exact_sums([values])[0] == 2.0
    assert np.sum(values) != 2.0


def test_subnormals_and_rounding_to_even():
    tiny = 5e-324
    assert exact_sums([np.full(7, tiny)])[0] == 7 * tiny
    assert exact_sums([np.array([1.0, 2.0**-53])])[0] == 1.0
    assert exact_sums([np.array([1.0, 2.0**-53, tiny])])[0] == 1.0 + 2.0**-52


def test_many_large_terms_carry_and_overflow():
    big = np.full(1000, np.finfo(float).max)
    assert exact_sums([np.concatenate([big, -big, [3.0]])])[0] == 3.0
    assert exact_sums([big])[0] == math.inf
    assert exact_sums([-big])[0] == -math.inf


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_term_that_is_not_finite_gives_nan_in_its_own_quantity_only(bad):
    sums = exact_sums([np.array([1.0, bad]), np.array([1.0, 2.0])])
    assert math.isnan(sums[0])
    assert sums[1] == 3.0


def test_columns_of_an_array_and_a_sequence_agree():
    rng = np.random.default_rng(3)
    table = rng.normal(size=(257, 11)) * 10.0 ** rng.integers(-200, 200, size=(257, 11))
    by_columns = exact_sums(table)
    by_sequence = exact_sums([table[:, q].reshape(257, 1, 1) for q in range(11)])
    assert by_columns.tobytes() == by_sequence.tobytes()
    assert by_columns.tolist() == [math.fsum(table[:, q]) for q in range(11)]
    assert exact_sums(np.asfortranarray(table)).tobytes() == by_columns.tobytes()


def test_a_rank_without_cells():
    assert exact_sums(np.empty((0, 3))).tolist() == [0.0, 0.0, 0.0]
    assert exact_sums([]).shape == (0,)


def test_wrong_shape_is_refused():
    with pytest.raises(ValueError, match=r"\(4,\)"):
        exact_sums(np.ones(4))
