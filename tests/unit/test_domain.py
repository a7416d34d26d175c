"""Space cut into ranks, and the ghost strips that travel between them."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rvm_mpi.grid.domain import FEWEST_CELLS, Domain, aligned, largest_ranks, partition
from rvm_mpi.job.job import Job, JobError

CELLS = st.one_of(st.just(()), st.tuples(st.integers(3, 300)), st.tuples(st.integers(3, 120), st.integers(3, 120)))


def make_job(cells, boundary="periodic", velocity=(4, 4)):
    directions = dict.fromkeys("xy"[: len(cells)], boundary)
    return Job.from_dict(
        {
            "space": {"cells": list(cells), "boundary": directions},
            "velocity": {"points": list(velocity)},
            "collision": {"operator": "none"},
            "initial": {"state": "uniform"},
            "time": {"end": 1.0},
        }
    )


@settings(max_examples=100, deadline=None)
@given(cells=CELLS, ranks=st.integers(1, 64))
def test_partition(cells, ranks):
    try:
        px, py = partition(cells, ranks)
    except JobError as error:
        assert ranks > 1
        line = str(error)
        assert line.startswith(f"{ranks} ranks cannot share") and "\n" not in line
        most = int(re.search(r"largest possible number below is (\d+)", line)[1])
        assert 1 <= most < ranks
        partition(cells, most)
        for between in range(most + 1, ranks):
            with pytest.raises(JobError):
                partition(cells, between)
        return
    assert px * py == ranks <= largest_ranks(cells)
    nx, ny = (*cells, 1, 1)[:2]
    for n, p in ((nx, px), (ny, py)):
        assert p == 1 or n // p >= FEWEST_CELLS


@settings(max_examples=100, deadline=None)
@given(cells=CELLS)
def test_the_largest_number_of_ranks_works_and_no_larger_one_does(cells):
    most = largest_ranks(cells)
    partition(cells, most)
    with pytest.raises(JobError, match=rf"largest possible number below is {most}$"):
        partition(cells, most + 1)


@pytest.mark.timeout(10)
def test_far_too_many_ranks_are_refused_at_once():
    """A slip in a job script must not keep 100,000 ranks busy with looking for a number that would do."""
    with pytest.raises(JobError, match=r"100000 ranks cannot share 64 x 64: .* largest possible number below is 441$"):
        partition((64, 64), 100_000)
    with pytest.raises(JobError, match=r"largest possible number below is 28900$"):
        partition((512, 512), 1_000_000)


def test_partitions_are_balanced_with_short_borders():
    assert partition((64, 64), 1) == (1, 1)
    # rows alone while they are cheaper, both ways when they are not
    assert [partition((64, 64), ranks) for ranks in (2, 3, 5)] == [(1, 2), (1, 3), (1, 5)]
    assert [partition((64, 64), ranks) for ranks in (4, 8)] == [(2, 2), (2, 4)]
    assert partition((40, 1000), 4) == (1, 4)
    # 17 cells by 12 with borders of 29 are less work than 33 by 6 with borders of 39, though more cells
    assert partition((66, 60), 20) == (4, 5)
    assert partition((64, 64), 16) == (4, 4)
    assert partition((200, 10), 4) == (4, 1)
    assert partition((10, 200), 4) == (1, 4)
    assert partition((), 1) == (1, 1)
    assert partition((9,), 3) == (3, 1)


@pytest.mark.parametrize("cells", [(7,), (5, 4)])
@pytest.mark.parametrize("boundary", ["periodic", "specular"])
@pytest.mark.parametrize("width", [1, 2, 3])
def test_exchange_on_one_rank(cells, boundary, width):
    domain = Domain(make_job(cells, boundary))
    array = domain.empty(width, 2)
    wy, wx = domain.ghosts(width)
    nx, ny = domain.cells
    assert array.shape == (ny + 2 * wy, nx + 2 * wx, 2)
    values = np.random.default_rng(0).random((ny, nx, 2))
    array[...] = -1.0
    array[wy : wy + ny, wx : wx + nx] = values
    domain.exchange(array, width)
    assert np.array_equal(array[wy : wy + ny, wx : wx + nx], values)
    around = np.full(array.shape, -1.0)
    around[wy : wy + ny, wx : wx + nx] = values
    if boundary == "periodic":
        around[wy : wy + ny] = np.pad(values, ((0, 0), (wx, wx), (0, 0)), mode="wrap")
        if len(cells) == 2:
            around[:, wx : wx + nx] = np.pad(values, ((wy, wy), (0, 0), (0, 0)), mode="wrap")
    assert np.array_equal(array, around)


def test_no_space_is_one_cell_without_ghosts():
    domain = Domain(make_job(()))
    assert (domain.dimensions, domain.cells, domain.local, domain.ghosts(2)) == (0, (1, 1), (1, 1), (0, 0))
    array = domain.empty(2, 3)
    domain.exchange(array, 2)
    assert array.shape == (1, 1, 3)
    assert not any(domain.on_side(name) for name in ("x-lower", "x-upper", "y-lower", "y-upper"))


def test_sides():
    one = Domain(make_job((5, 4), "vacuum"))
    assert all(one.on_side(name) for name in ("x-lower", "x-upper", "y-lower", "y-upper"))
    assert not Domain(make_job((5,))).on_side("x-lower")  # periodic
    assert not Domain(make_job((5,), "vacuum")).on_side("y-lower")


def test_exchange_refuses_what_is_not_contiguous():
    domain = Domain(make_job((5, 4)))
    with pytest.raises(ValueError, match="contiguous"):
        domain.exchange(domain.empty(2, 4)[:, :, ::2], 2)


@pytest.mark.parametrize("guard", [0, 3, 8, 100])
def test_aligned(guard):
    for size in range(1, 12):
        array = aligned((size, 3), guard)
        assert array.ctypes.data % 64 == 0 and array.shape == (size, 3)
        base = array
        while base.base is not None:
            base = base.base
        before = (array.ctypes.data - base.ctypes.data) // 8
        assert before >= guard and base.size - before - array.size >= guard
        assert not base.any()


def test_counts_fit_in_32_bits_at_the_largest_grids():
    """Strips are counted in cells: 256 x 256 cells of 32^3 velocities have 2.1e9 unknowns on one rank."""
    domain = Domain(make_job((256, 256)))
    block, nx, ny, width = 32**3, 256, 256, 2
    shape = (ny + 2 * width, nx + 2 * width, block)
    assert np.prod(shape, dtype=np.int64) > 2**31
    for neighbour in domain._neighbours:
        for strip in domain._strips(neighbour, shape, width):
            datatype = domain._datatype(shape, strip)
            cells = [part.stop - part.start for part in strip]
            assert sorted(cells) == [width, 256]
            assert datatype.Get_size() == 8 * block * width * 256
            lower, extent = datatype.Get_extent()
            assert (lower, extent) == (0, 8 * np.prod(shape, dtype=np.int64))
            # what MPI counts are blocks of a cell, in a grid of cells
            _counts, _addresses, _types, combiner = datatype.Get_envelope()[:4]
            integers = datatype.Get_contents()[0]
            assert max(integers) <= 260
            del combiner


EXCHANGE = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from test_domain import make_job
from rvm_mpi.grid.domain import Domain
for cells in ((14,), (13, 12)):
    for boundary in ("periodic", "specular"):
        domain = Domain(make_job(cells, boundary))
        nx, ny = domain.cells
        (i0, j0), (mx, my) = domain.start, domain.local
        whole = np.random.default_rng(1).random((ny, nx, 5))
        for width in (1, 2, 3):
            wy, wx = domain.ghosts(width)
            array = domain.empty(width, 5)
            array[...] = -1.0
            array[wy : wy + my, wx : wx + mx] = whole[j0 : j0 + my, i0 : i0 + mx]
            domain.exchange(array, width)
            for j in range(-wy, my + wy):
                for i in range(-wx, mx + wx):
                    corner = not (0 <= j < my) and not (0 <= i < mx)
                    inside = 0 <= i0 + i < nx and 0 <= j0 + j < ny
                    expected = whole[(j0 + j) % ny, (i0 + i) % nx]
                    if corner or (boundary != "periodic" and not inside):
                        expected = -1.0
                    assert np.all(array[wy + j, wx + i] == expected), (cells, boundary, width, domain.rank, i, j)
        for name, at in (("x-lower", i0 == 0), ("x-upper", i0 + mx == nx)):
            assert domain.on_side(name) == (boundary != "periodic" and at)
        assert domain.maximum(float(domain.rank), -1.0) == [domain.size - 1.0, -1.0]
        total = domain.comm.allreduce(mx * my)
        assert total == nx * ny
print("good")
"""


@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
def test_ghosts_are_the_neighbours_cells(mpirun, ranks):
    """In one and two dimensions, periodic and not, every ghost strip is that of the global array; corners stay."""
    done = mpirun(ranks, "-c", EXCHANGE, __file__.rpartition("/")[0])
    # ranks may write into each other's lines
    assert (done.returncode, done.stdout.count("good")) == (0, ranks), done.stderr
