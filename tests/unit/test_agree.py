"""The agreement of all ranks on an error; on one rank and, in threads, on several."""

import pickle
import threading

import numpy as np
import pytest

from rvm_mpi.agree import DiskFailure, agreed, agreed_on_disk, on_rank_0, raise_on_all
from rvm_mpi.job.text import JobError


class Ranks:
    """What the communicators of several threads share."""

    def __init__(self, size):
        self.size, self.barrier, self.values = size, threading.Barrier(size, timeout=20), [None] * size


class Rank:
    """As much of a communicator as an agreement uses."""

    def __init__(self, ranks, rank):
        self.ranks, self.rank, self.size, self.calls = ranks, rank, ranks.size, []

    def allgather(self, value):
        self.calls.append("allgather")
        self.ranks.values[self.rank] = value
        self.ranks.barrier.wait()
        values = pickle.loads(pickle.dumps(self.ranks.values))  # as MPI would
        self.ranks.barrier.wait()
        return values

    def Allreduce(self, _in_place, array, op):
        values = self.allgather(array.copy())
        self.calls[-1] = "Allreduce"
        array[...] = np.max(values, axis=0)


def on_all(size, action):
    """What each rank returns or raises, and the calls it made."""
    ranks, found = Ranks(size), [None] * size
    comms = [Rank(ranks, k) for k in range(size)]

    def one(k):
        try:
            found[k] = action(comms[k])
        except Exception as error:
            found[k] = error

    threads = [threading.Thread(target=one, args=(k,)) for k in range(size)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    assert not any(thread.is_alive() for thread in threads)
    return found, [comm.calls for comm in comms]


def test_one_rank_fails_and_all_raise():
    def act(comm):
        with agreed(comm, lambda why: JobError(f"wrong: {why}")):
            if comm.rank == 1:
                raise ValueError("two\n lines")

    found, calls = on_all(3, act)
    assert [(type(one), str(one)) for one in found] == [(JobError, "wrong: two lines")] * 3
    assert calls == [["Allreduce", "allgather"]] * 3
    assert isinstance(found[1].__cause__, ValueError)


def test_where_nothing_is_wrong_one_number_goes_round():
    def act(comm):
        with agreed_on_disk(comm, "x cannot be written"):
            pass
        return on_rank_0(comm, lambda: 7)

    found, calls = on_all(2, act)
    assert found == [7, None]
    assert calls == [["Allreduce", "Allreduce"]] * 2


@pytest.mark.parametrize("size", [1, 2])
@pytest.mark.parametrize(("error", "raised"), [(JobError("no"), JobError), (OSError(28, "full"), DiskFailure),
                                               (DiskFailure("lost"), DiskFailure)])
def test_what_rank_0_cannot_do(size, error, raised):
    def act(comm):
        def action():
            raise error

        return on_rank_0(comm, action)

    found, _ = on_all(size, act)
    assert [(type(one), str(one)) for one in found] == [(raised, str(error))] * size


def test_on_disk():
    def act(comm):
        with agreed_on_disk(comm, "x cannot be written"):
            raise OSError

    (alone,), _ = on_all(1, act)
    assert str(alone) == "x cannot be written: OSError" and isinstance(alone, DiskFailure)
    found, _ = on_all(2, act)
    assert len({str(one) for one in found}) == 1 and str(found[0]).startswith("x cannot be written: OSError (rank ")


def test_nothing_to_raise():
    assert on_all(2, lambda comm: raise_on_all(comm, None))[0] == [None, None]
