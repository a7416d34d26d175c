"""Two runs in one directory, and a directory that is moved away under a run."""

import re
import time

import pytest
from faults.faulty import COMPILING, Started, assert_same, run, wait_for

from rvm_mpi.commands.main import main
from rvm_mpi.output import rundir
from rvm_mpi.results import open_run

pytestmark = pytest.mark.timeout(900)

#: what is there instead, and whether the run is held between two steps or may be within a checkpoint's write
MOVES = ["another run in its place", "nothing in its place", "at any moment"]
HELD = ["hold:step:all:6"]


def contents(directory):
    return {path.name: path.read_bytes() for path in directory.iterdir() if path.name != "lock"}


@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_beside_a_run_every_other_is_refused(place, whole, ranks, capsys):
    job, directory = place / "job.toml", place / "run"
    with Started(ranks, HELD, "run", job, "--output", directory, "--quiet", log=place / "log") as started:
        wait_for(lambda: rundir.checkpoints(directory), started)
        for number, options in enumerate((["--restart"], ["--overwrite"], [])):
            status, lines = run(
                number + 1, [], job, "--output", directory, *options, log=place / f"log-{number}", bound=COMPILING
            )
            assert started.process.poll() is None, started.log.read_text()
            assert status == 2
            words = rf"rvm: {directory}: a run on .* \(process (\d+), since .*\) is writing into it; .*"
            found = re.fullmatch(words, lines[0])
            assert found, lines
            assert int(found[1]) in started.find_ranks()
        assert main(["info", str(directory)]) == 0
        assert re.search(rf"^running +now: a run on .* \(process {found[1]}, ", capsys.readouterr().out, re.MULTILINE)
        (place / "go").touch()
        assert started.wait() == 0
    assert started.lines() == []
    assert [path.name for path in place.iterdir() if "old" in path.name] == []
    assert not (directory / "lock").exists()
    assert_same(directory, whole)
    assert main(["info", str(directory)]) == 0
    assert "running" not in capsys.readouterr().out


def test_of_two_that_overwrite_at_one_instant_one_is_refused(place, whole):
    job, directory = place / "job.toml", place / "run"
    assert run(1, [], job, "--output", directory, "--quiet", log=place / "log") == (0, [])
    old = contents(directory)
    options = ["run", job, "--output", directory, "--quiet", "--overwrite"]
    with (
        Started(1, HELD, *options, log=place / "log-1") as one,
        Started(1, HELD, *options, log=place / "log-2") as other,
    ):
        wait_for(lambda: other.process.poll() is not None, one)
        (place / "go").touch()
        said = sorted((started.wait(), started.lines()) for started in (one, other))
    assert [status for status, _ in said] == [0, 2], said
    assert "is writing into it" in said[1][1][0]
    assert_same(directory, whole)
    assert contents(place / "run-old-1") == old
    assert not (place / "run-old-2").exists()


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize(("again", "held"), [(True, True), (False, True), (False, False)], ids=MOVES)
def test_a_run_whose_directory_is_moved_away_stops(place, whole, ranks, again, held):
    """It writes nothing into what another run has made in the meantime."""
    job, directory, aside = place / "job.toml", place / "run", place / "aside"
    with Started(ranks, HELD, "run", job, "--output", directory, "--quiet", log=place / "log") as started:
        wait_for((place / "held").exists if held else lambda: rundir.checkpoints(directory), started)
        directory.rename(aside)
        if again:
            assert run(1, [], job, "--output", directory, "--quiet", log=place / "log-2") == (0, [])
        (place / "go").touch()
        assert started.wait() == 3
        lines = started.lines()
    assert len(lines) == 1
    words = rf"rvm: job: {directory} is no longer this run's: .*; nothing more is written; step \d+, t = "
    assert re.match(words, lines[0])
    if again:
        assert_same(directory, whole)
        assert not list(directory.glob("*.part"))
    else:
        assert not directory.exists()
    assert open_run(aside).time.values[0] == 0.0
    assert lines[0] in (aside / "run.log").read_text()
    # what a dead run left is taken over at once
    begin = time.monotonic()
    assert run(ranks, [], job, "--output", aside, "--quiet", "--restart", log=place / "log-3") == (0, [])
    assert time.monotonic() - begin < 60.0
    assert_same(aside, whole)
