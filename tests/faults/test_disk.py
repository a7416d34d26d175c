"""A disk that is full, a device that always is, a folder that cannot be written to or goes away under the run."""

import contextlib
import os
import subprocess

import pytest
from faults.faulty import assert_readable, assert_same, run

pytestmark = pytest.mark.timeout(600)

SELDOM = ("--set", 'output.checkpoint_every="1 h"')


@contextlib.contextmanager
def small_disk(folder, size):
    """A disk of its own in memory. Only root may mount one; the limits of file sizes below are there for all."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True)
    if done.returncode != 0:
        pytest.skip(f"no small disk here, files of limited size are tried in its place: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


def assert_ends(place, directory, faults, words, *options, ranks=2):
    """The run ends with 3 and one line that has these words."""
    arguments = [place / "job.toml", "--output", directory, *options]
    status, lines = run(ranks, faults, *arguments, log=place / "log")
    assert status == 3, (place / "log").read_text()
    # a limit on the size of files may reach the log as well, which is said and does not end the run
    lines = [line for line in lines if not line.endswith("run.log cannot be written: File too large; going on")]
    assert len(lines) == 1, (place / "log").read_text()
    for word in words:
        assert word in lines[0]


def assert_goes_on(place, directory, whole):
    options = ["--output", directory, "--restart", "--quiet"]
    status, lines = run(2, [], place / "job.toml", *options, log=place / "log")
    assert (status, lines) == (0, []), (place / "log").read_text()
    assert_same(directory, whole)


#: what a file that cannot grow stops: the fault, the words of the line
LIMITS = {
    "history": ("full:history:0:6", ["history.csv cannot be written: ", "the checkpoint of step 4 is there"]),
    "device": ("device:history:0:6", ["history.csv cannot be written: ", "No space left", "step 4 is there"]),
    "fields": ("full:fields:1:3", ["fields.h5 cannot take snapshot 2 at t = 0.02", "(rank 1)", "is there"]),
    "description": ("full:xdmf:0:3", ["fields.xdmf cannot be written: File too large", "is there"]),
    "checkpoint": ("full:sums:1:11", ["checkpoint-00000004.h5 cannot be written", "the checkpoint of step 3"]),
    "a checkpoint's header": ("full:create:0:4", ["checkpoint-00000004.h5 cannot be written", "step 3 is there"]),
}
QUICK = ("device", "checkpoint")


@pytest.mark.parametrize(
    "case", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in LIMITS]
)
def test_a_file_that_cannot_grow(place, whole, case, tally):
    fault, words = LIMITS[case]
    directory = place / "run"
    assert_ends(place, directory, [fault], words)
    assert_readable(directory, whole)
    assert_goes_on(place, directory, whole)
    tally["disks full"] += 1


@pytest.mark.parametrize(
    ("case", "fault", "words"),
    [
        ("fields", "fill:open:0:1", ["fields.h5 cannot be created", "No space left"]),
        ("checkpoint", "fill:checkpoint:0:4", ["checkpoint-00000004.h5 cannot be written", "No space left"]),
        ("in a checkpoint", "fill:blocks:0:4", ["checkpoint-00000004.h5 cannot be written", "step 3 is there"]),
    ],
)
def test_a_full_disk(place, whole, case, fault, words, tally):
    """Filled to its last byte, freed, gone on from."""
    with small_disk(place / "disk", "8m") as disk:
        directory = disk / "run"
        assert_ends(place, directory, [fault], words)
        (disk / "filler").unlink()
        if case != "fields":
            assert_readable(directory, whole)
            assert_goes_on(place, directory, whole)
        tally["disks full"] += 1


def test_a_full_disk_for_the_history(place, whole, tally):
    """Rows of some hundred bytes: the file's last block is soon used up, long before another checkpoint is due."""
    with small_disk(place / "disk", "8m") as disk:
        first = [place / "job.toml", "--output", disk / "run"]
        assert run(2, [], *first, "--set", "time.max_steps=3", log=place / "log") == (0, [])
        more = ["--restart", *SELDOM, "--set", "time.max_steps=400"]
        words = ["history.csv cannot be written: ", "No space left", "the checkpoint of step 3 is there"]
        assert_ends(place, disk / "run", ["fill:history:0:1"], words, *more)
        (disk / "filler").unlink()
        assert_goes_on(place, disk / "run", whole)
        tally["disks full"] += 1


def test_a_log_that_cannot_be_written_does_not_end_the_run(place, whole):
    directory = place / "run"
    first = [place / "job.toml", "--output", directory]
    assert run(2, [], *first, "--set", "time.max_steps=3", log=place / "log") == (0, [])
    (directory / "run.log").unlink()
    (directory / "run.log").symlink_to("/dev/full")
    status, lines = run(2, [], *first, "--restart", log=place / "log")
    assert status == 0, (place / "log").read_text()
    assert len(lines) == 1
    assert f"{directory}/run.log cannot be written: " in lines[0]
    assert_same(directory, whole)


@pytest.mark.long
@pytest.mark.parametrize("often", [True, False], ids=["checkpoints", "no checkpoint due"])
def test_the_output_is_removed_under_the_run(place, often):
    """Found out by the next thing that is written by its name, at the latest by the next checkpoint."""
    directory = place / "run"
    words = [f"{directory} is no longer this run's: it was moved, or its lock removed"]
    assert_ends(place, directory, ["remove:step:0:6"], words, *(() if often else SELDOM))


@contextlib.contextmanager
def unwritable(folder):
    """Not even root may write to a disk that is mounted so."""
    if os.geteuid() != 0:
        folder.mkdir(mode=0o555)
        yield folder
        return
    with small_disk(folder, "1m"):
        subprocess.run(["mount", "-o", "remount,ro", folder], check=True)
        yield folder


def test_an_unwritable_folder_is_refused(place):
    with unwritable(place / "folder") as folder:
        options = ["--output", folder / "run"]
        status, lines = run(2, [], place / "job.toml", *options, log=place / "log")
    assert status == 2
    assert lines[0] == f"rvm: {folder}/run: no permission to write in {folder}"
    # on a busy machine another rank may repeat it before it is ended
    assert all(line.endswith(lines[0].removeprefix("rvm: ")) for line in lines)
