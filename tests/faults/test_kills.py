"""kill -9 of a rank, of mpirun, of everything: the run goes on from what is there, and ends with the same bits."""

import math
import random
import signal
import time

import pytest
from faults.faulty import Started, assert_readable, assert_same, descendants, kill, run, wait_for

from rvm_mpi.output import rundir

pytestmark = pytest.mark.timeout(900)

#: places in a checkpoint's write that a rank can be killed at, with the number of times they have been passed in the
#: third checkpoint (`flush`: rank 1 once before the write and once in it; rank 0 twice before, twice in it, once after)
IN_A_CHECKPOINT = ["create:0:3", "blocks:1:3", "sums:0:7", "flush:0:14", "flush:1:6", "checkpoint:1:3"]
QUICK = "sums:0:7"
#: places where a checkpoint takes its time: most of a run is then within a write
SLOW = ["0.1:create:0:each", "0.1:sums:all:each", "0.1:flush:all:each"]


def go_on(directory):
    """What a user or a job script types next: with a checkpoint --restart, without one --overwrite."""
    return "--restart" if rundir.checkpoints(directory) else "--overwrite"


def assert_goes_on(place, whole, ranks):
    directory = place / "run"
    how = go_on(directory)
    status, lines = run(ranks, [], place / "job.toml", "--output", directory, how, log=place / "log")
    assert (status, lines) == (0, []), (place / "log").read_text()
    assert_same(directory, whole)
    assert not list(directory.glob("*.part"))


@pytest.mark.parametrize(
    "where", [place if place == QUICK else pytest.param(place, marks=pytest.mark.long) for place in IN_A_CHECKPOINT]
)
def test_killed_at_a_known_place_of_a_checkpoint(place, whole, where):
    directory = place / "run"
    status, _ = run(2, [f"kill:{where}"], place / "job.toml", "--output", directory, log=place / "log")
    assert status != 0
    assert [p.name for p in rundir.checkpoints(directory)][-1] == "checkpoint-00000002.h5"
    assert_readable(directory, whole)
    assert_goes_on(place, whole, ranks=3)


def strike(started, target, tally):
    """kill -9, and what was being written then."""
    ranks = started.find_ranks()
    victims = {
        "rank 0": ranks[:1],
        "rank 1": ranks[1:2],
        "all ranks": ranks,
        "mpirun": [started.process.pid],
        "mpirun and all ranks": [started.process.pid, *ranks],
    }[target]
    for pid in victims:
        kill(pid, signal.SIGKILL)
    tally[f"kills of {target}"] += 1


def assert_killed_over_and_over_and_whole(place, whole, seed, kills, tally):
    """Kill one run so many times, each time going on on another number of ranks; then let it end."""
    draw, directory = random.Random(seed), place / "run"
    for number in range(kills):
        options = [go_on(directory)] if number else []
        arguments = ["run", place / "job.toml", "--output", directory, *options]
        target = draw.choice(["rank 0", "rank 1", "all ranks", "mpirun", "mpirun and all ranks"])
        early, delay = draw.random() < 0.2, draw.random()
        before = set(directory.glob("checkpoint-*"))
        with Started(draw.choice([2, 2, 3]), SLOW, *arguments, log=place / f"log-{number}") as started:
            wait_for(lambda: len(descendants(started.process.pid)) >= 2, started)
            if early:
                time.sleep(3.0 * delay)
            else:
                wait_for(lambda: set(directory.glob("checkpoint-*")) - before, started)  # noqa: B023
                time.sleep(0.8 * delay)
            ended = started.process.poll() is not None
            assert not ended, started.log.read_text()
            strike(started, target, tally)
            began = time.monotonic()
            status = started.wait()
            seconds = math.ceil(time.monotonic() - began)
            name = "seconds at most until nothing of a killed run was left"
            tally[name] = max(tally[name], seconds)
        assert status != 0
        within = bool(list(directory.glob("checkpoint-*.part")))
        tally["kills within a checkpoint's write" if within else "kills elsewhere"] += 1
        if directory.exists():
            assert_readable(directory, whole)
    assert_goes_on(place, whole, ranks=draw.choice([1, 2, 3]))
    tally["runs killed over and over whose bits are those of an undisturbed run"] += 1


def test_killed_at_random_moments(place, whole, tally):
    assert_killed_over_and_over_and_whole(place, whole, seed=0, kills=2, tally=tally)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1, 11))
def test_killed_at_fifty_random_moments(place, whole, tally, seed):
    assert_killed_over_and_over_and_whole(place, whole, seed, kills=5, tally=tally)
