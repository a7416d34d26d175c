"""Started under mpirun by `test_weights.py`: ranks share the Boltzmann weights, or the one that makes them fails."""

import hashlib
import sys
import time

from mpi4py import MPI

from rvm_mpi.collisions import weight_store
from rvm_mpi.commands.main import main
from rvm_mpi.job.text import JobError

POINTS = (10, 12)
world = MPI.COMM_WORLD


def fail(*_):
    raise MemoryError("no room for the weights")


def share() -> None:
    """What the ranks see, how often the weights were made, and what one rank writes into them."""
    calls, compute = [], weight_store.compute_weights
    weight_store.compute_weights = lambda *arguments: calls.append(1) or compute(*arguments)
    weights = weight_store.shared_weights(world, POINTS, 0.7, 0.5)
    assert not weights.flags.writeable
    digests = world.allgather(hashlib.sha256(weights).hexdigest())
    made = world.allreduce(len(calls))
    if world.rank == 0:
        weights.flags.writeable = True
        weights[3] = 42.0
    world.Barrier()
    seen = world.allgather(float(weights[3]))
    if world.rank == 0:
        print(made, len(set(digests)), digests[0], sorted(set(seen)))


def fail_on_one() -> None:
    """The other ranks hear of it."""
    weight_store.compute_weights = fail
    try:
        weight_store.shared_weights(world, POINTS, 0.7, 0.5)
        said = "nothing"
    except JobError as error:
        said = str(error)
    everywhere = world.gather(said)
    if world.rank == 0:
        print(len(set(everywhere)), everywhere[0])


def command() -> int:
    """`rvm run` of a job whose weights cannot be made."""
    weight_store.compute_weights = fail
    return main(["run", *sys.argv[2:]])


def without_room() -> int:
    """`rvm run` where the first rank has no shared memory and the others wait for it, as Open MPI has it."""

    class Full:
        def Allocate_shared(*_, **__):
            if world.rank == 0:
                raise MPI.Exception(MPI.ERR_INTERN)
            time.sleep(600)

    MPI.Win = Full
    return main(["run", *sys.argv[2:]])


sys.exit({"share": share, "fail": fail_on_one, "command": command, "room": without_room}[sys.argv[1]]())
