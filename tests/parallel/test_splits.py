"""A job gives the same bits however its cells are split over the ranks, and whichever rank has which of them."""

from pathlib import Path

import pytest
from parallel import rank_jobs
from parallel.test_ranks import datasets

SPLIT = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from rvm_mpi.grid import domain
split = int(sys.argv[2]), int(sys.argv[3])
domain.partition = lambda cells, ranks: split
create = domain.Domain.__init__
def checked(self, job, comm=None):
    create(self, job, comm)
    assert [n < whole for n, whole in zip(self.local, self.cells)] == [p > 1 for p in split]
domain.Domain.__init__ = checked
from parallel import rank_jobs
assert rank_jobs.run(Path(sys.argv[4]), sys.argv[5:]) == 0
"""
#: with a side of every kind, with the fluid's omega, with ghosts from one and the same neighbour on both sides
JOBS = ("periodic", "walls", "paper")
SPLITS = ((2, 1), (1, 4), (4, 1), (2, 2), (3, 2))


@pytest.fixture(scope="module")
def whole(mpirun, tmp_path_factory):
    """The directory of the runs on one rank."""
    return split_run(mpirun, tmp_path_factory.mktemp("whole"), (1, 1))


def split_run(mpirun, directory, split):
    rank_jobs.write(directory)
    tests = Path(__file__).parents[1]
    done = mpirun(split[0] * split[1], "-c", SPLIT, tests, str(split[0]), str(split[1]), directory, *JOBS, timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr
    return directory


@pytest.mark.timeout(500)
@pytest.mark.parametrize("split", SPLITS)
def test_same_bits_on_any_decomposition(mpirun, tmp_path, whole, split):
    directory = split_run(mpirun, tmp_path, split)
    for job in JOBS:
        one, other = datasets(whole / job), datasets(directory / job)
        assert set(other) == set(one)
        different = [name for name in one if one[name].tobytes() != other[name].tobytes()]
        assert not different, job
        assert (directory / job / "history.csv").read_bytes() == (whole / job / "history.csv").read_bytes(), job


TILES = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from mpi4py import MPI
from rvm_mpi.grid import domain
from rvm_mpi.grid import placement
domain.partition = lambda cells, ranks: (2, 2)
placement.nodes = lambda comm: [0, 0, 1, 1]
from parallel import rank_jobs
create = domain.Domain.__init__
def checked(self, job, comm=None):
    create(self, job, comm)
    # the second rank of the first node has the part beside the first's that shares its longer side
    beside = {0: (0, 0), 1: (0, 1), 2: (1, 0), 3: (1, 1)}[MPI.COMM_WORLD.rank]
    assert [start > 0 for start in self.start] == [bool(q) for q in beside], self.start
domain.Domain.__init__ = checked
assert rank_jobs.run(Path(sys.argv[2]), sys.argv[3:]) == 0
"""


@pytest.mark.timeout(250)
def test_same_bits_with_the_ranks_of_a_node_in_a_tile(mpirun, tmp_path, whole):
    """Two nodes of two ranks; a rank's cells are wider than high, so that columns cut less than rows."""
    rank_jobs.write(tmp_path)
    done = mpirun(4, "-c", TILES, Path(__file__).parents[1], tmp_path, "walls", timeout=200)
    assert done.returncode == 0, done.stdout + done.stderr
    one, other = datasets(whole / "walls"), datasets(tmp_path / "walls")
    assert [name for name in one if one[name].tobytes() != other[name].tobytes()] == []
    assert (tmp_path / "walls" / "history.csv").read_bytes() == (whole / "walls" / "history.csv").read_bytes()
