"""Kernels are called with what numba knows of their arguments, at once and each time."""

import resource
from typing import NamedTuple

import numpy as np
import pytest

from rvm_mpi.compiling.declare import kernel


class Inner(NamedTuple):
    array_of_the_inner: np.ndarray
    number_of_the_inner: float


class Outer(NamedTuple):
    a_number_with_a_long_name: int
    another_with_a_longer_name: float
    inner_of_the_outer: Inner
    flat_array: np.ndarray


def total(outer, more):
    inner = outer.inner_of_the_outer
    found = outer.a_number_with_a_long_name * outer.another_with_a_longer_name + inner.number_of_the_inner + more
    for value in outer.flat_array.flat:
        found += value
    for value in inner.array_of_the_inner.flat:
        found += value
    return found


def make(array, flat):
    return Outer(2, 1.5, Inner(array, 0.25), flat)


ARRAYS = {
    "rows": np.ones((4, 6)), "columns": np.ones((4, 6), order="F"), "every other": np.ones((8, 12))[::2, ::2],
    "whole numbers": np.ones((4, 6), dtype=np.int64), "three axes": np.ones((4, 3, 2)), "single": np.ones((24, 1)),
}  # fmt: skip


@pytest.mark.parametrize("name", ARRAYS)
def test_each_kind_of_argument_is_told_from_the_others(name):
    """One kernel, called in turn with arrays that lie differently in memory."""
    summed = kernel(total)
    for array in (ARRAYS["rows"], ARRAYS[name], ARRAYS["rows"], ARRAYS[name]):
        assert summed(make(array, np.full(3, 2.0)), 1.0) == 3.0 + 0.25 + 1.0 + 24.0 + 6.0


def test_calls_keep_no_memory():
    """numba 0.56 did not know a NamedTuple again when other memory had been used in between: a leak, and slow."""
    summed = kernel(total)
    rng = np.random.default_rng(1)

    def call(times):
        for _ in range(times):
            disturbed = [rng.bytes(int(n)) for n in rng.integers(20, 400, 50)]  # what lies where numba looks
            del disturbed
            assert summed(make(np.ones((2, 2)), np.ones(3)), 1.0) == 3.0 + 0.25 + 1.0 + 4.0 + 3.0

    call(500)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    call(4000)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1000  # kilobytes
