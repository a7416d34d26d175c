"""`rvm compare`: the same or not, what differs first, and what cannot be compared."""

import shutil

import h5py
import numpy as np
import pytest

from rvm_mpi.commands.main import main
from rvm_mpi.job.job import Job
from rvm_mpi.run.run import run_job

TABLES = {
    "space": {"cells": [5, 4], "boundary": {"x": "diffuse"}},
    "velocity": {"points": [8, 8]},
    "collision": {"operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.9},
    "fluid": {"enabled": True},
    "initial": {"state": "random-density", "low": 0.5},
    "time": {"end": 0.02},
    "output": {"times": [0.0, 0.01, 0.02]},
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished run."""
    path = tmp_path_factory.mktemp("run") / "one"
    assert run_job(Job.from_dict(TABLES, "one"), path, quiet=True) == 0
    return path


@pytest.fixture
def copy(run, tmp_path):
    """A copy of it, to be changed."""
    shutil.copytree(run, tmp_path / "two")
    return tmp_path / "two"


@pytest.fixture
def compared(capsys):
    """Run the command: exit status, lines of stdout, and what stderr says."""

    def compare(*arguments):
        status = main(["compare", *map(str, arguments)])
        captured = capsys.readouterr()
        return status, captured.out.splitlines(), captured.err

    return compare


def newest(run):
    return max(run.glob("checkpoint-*.h5"))


def edit(path, name, index, change):
    with h5py.File(path, "r+") as file:
        file[name][index] = change(file[name][index])


def test_a_copy_is_the_same(run, copy, compared):
    (copy / "run.log").write_text("another machine, another time")
    for pair in ((run, copy), (newest(run), newest(copy))):
        status, lines, err = compared(*pair)
        assert (status, err) == (0, "")
        assert len(lines) == 1 and "are the same bit for bit" in lines[0]


def test_one_bit_of_a_field(run, copy, compared):
    edit(copy / "fields.h5", "kinetic/velocity", (1, 2, 3, 1), lambda value: np.nextafter(value, 9.0))
    status, lines, _ = compared(run, copy)
    assert status == 1
    assert lines[0].startswith("fields.h5: first kinetic/velocity in snapshot 1 (t = 0.01), cell (3, 2), component y: ")
    assert lines[1].startswith("fields.h5: largest of kinetic/velocity in snapshot 1 (t = 0.01), cell (3, 2), ")
    assert len(lines) == 3 and "not the same bit for bit" in lines[2]
    assert compared(run, copy, "--tolerance", "1e-12")[0] == 0


def test_the_first_is_the_first_in_time_and_the_largest_is_by_how_much(run, copy, compared):
    fields = copy / "fields.h5"
    edit(fields, "kinetic/density", (2, 1, 1), lambda value: value + 0.25)
    edit(fields, "scaling/omega", (1, 3, 4), lambda value: value + 0.125)
    with h5py.File(run / "fields.h5") as file:
        largest = file["kinetic/density"][2, 1, 1] + 0.25
        size = max(largest, file["kinetic/density"][...].max())
    status, lines, _ = compared(run, copy)
    assert status == 1
    assert "first scaling/omega in snapshot 1 (t = 0.01), cell (4, 3)" in lines[0]
    worst = next(line for line in lines if "largest of kinetic/density" in line)
    assert worst.endswith(f"in snapshot 2 (t = 0.02), cell (1, 1): 0.25, relative {0.25 / size:.3g}")
    # within a tolerance between the two, only the larger remains
    status, lines, _ = compared(run, copy, "--tolerance", 0.2 / size)
    assert status == 1 and not any("omega" in line for line in lines)
    assert compared(run, copy, "--tolerance", 0.26 / size)[0] == 0


def test_a_number_that_is_none(run, copy, compared):
    edit(copy / "fields.h5", "kinetic/temperature", (0, 0, 0), lambda value: np.nan)
    for tolerance in ((), ("--tolerance", "1e3")):
        status, lines, _ = compared(run, copy, *tolerance)
        assert status == 1
        assert lines[0].endswith(" and nan") and "cell (0, 0)" in lines[0]
    edit(run / "fields.h5", "kinetic/temperature", (0, 0, 0), lambda value: np.nan)
    try:
        assert compared(run, copy)[0] == 0  # in the same place
    finally:
        edit(run / "fields.h5", "kinetic/temperature", (0, 0, 0), lambda value: 1.0)


def test_history(run, copy, compared):
    history = copy / "history.csv"
    rows = history.read_text().splitlines()
    names = rows[0].split(",")
    cells, first = rows[4].split(","), rows[1].split(",")
    energy, largest = (float(row[names.index("energy")]) for row in (cells, first))  # the gas cools
    cells[names.index("energy")] = repr(energy + 1e-6 * largest)
    history.write_text("\n".join([*rows[:4], ",".join(cells), *rows[5:]]) + "\n")
    status, lines, _ = compared(run, copy)
    assert status == 1
    assert lines[0].startswith("history.csv: first energy in step 3: ")
    assert "relative 1e-06" in lines[1]
    assert compared(run, copy, "--tolerance", "2e-6")[0] == 0


def test_a_run_that_is_still_being_written(run, copy, compared):
    """One snapshot fewer, fewer rows, the last of them half there: what there is agrees."""
    history = copy / "history.csv"
    text = history.read_text()
    rows = text.count("\n") - 1
    history.write_text(text[:-30])
    edit(copy / "fields.h5", "time", 2, lambda value: np.nan)
    edit(copy / "fields.h5", "kinetic/density", 2, lambda value: -value)
    status, lines, err = compared(run, copy)
    assert (status, err) == (1, "")
    assert lines[:2] == [
        f"history.csv: {rows} rows in the first, {rows - 1} in the second",
        "fields.h5: snapshot 2 (t = 0.02) is in the first only",
    ]
    assert len(lines) == 3


def test_other_shapes_and_datasets(run, tmp_path, compared):
    other = {**TABLES, "space": {"cells": [6, 4]}, "fluid": {"enabled": False}}
    assert run_job(Job.from_dict(other, "other"), tmp_path / "other", quiet=True) == 0
    status, lines, err = compared(run, tmp_path / "other")
    assert (status, err) == (1, "")
    assert any("the jobs differ: " in line and "space.cells is [5, 4] and [6, 4]" in line for line in lines)
    assert "fields.h5: kinetic/density has shape (3, 4, 5) and (3, 4, 6)" in lines
    assert "fields.h5: fluid/density is in the first only" in lines


@pytest.mark.parametrize(
    ("name", "index", "place"),
    [("g", (2, 3, 17), "g in cell (3, 2), node 17"), ("cells", (1, 0, 0), "omega in cell (0, 1)")],
)
def test_one_bit_of_a_checkpoint(run, copy, compared, name, index, place):
    edit(newest(copy), name, index, lambda value: np.nextafter(value, 9.0))
    status, lines, _ = compared(newest(run), newest(copy))
    assert status == 1
    assert lines[0].startswith(f"the checkpoints: first {place}")
    assert compared(newest(run), newest(copy), "--tolerance", "1e-12")[0] == 0


def test_a_checkpoint_of_another_step(run, tmp_path, compared):
    other = {**TABLES, "time": {"end": 0.02, "max_steps": 2}}
    assert run_job(Job.from_dict(other, "other"), tmp_path / "other", quiet=True) == 0
    status, lines, _ = compared(newest(run), newest(tmp_path / "other"))
    assert status == 1
    assert "numbers/time" in lines[0]


def test_what_cannot_be_compared(run, copy, tmp_path, compared):
    (tmp_path / "empty").mkdir()
    (tmp_path / "text").write_text("nothing")
    half = tmp_path / "half.h5"
    half.write_bytes(newest(run).read_bytes()[:3000])
    (copy / "fields.h5").unlink()
    wrong = {
        (run, tmp_path / "none"): "no such file or directory",
        (run, tmp_path / "empty"): "holds no run",
        (run, newest(run)): "a run directory and a file cannot be compared",
        (newest(run), tmp_path / "text"): "is no checkpoint that can be read",
        (newest(run), half): "is no checkpoint that can be read",
        (newest(run), run / "fields.h5"): "is no checkpoint that can be read",
        (run, copy): "has no fields.h5",
        (run, run, "--tolerance", "-1"): "is not a number from 0 on",
        (run, run, "--tolerance", "nan"): "is not a number from 0 on",
    }
    for arguments, words in wrong.items():
        status, lines, err = compared(*arguments)
        assert (status, lines) == (2, []), arguments
        assert err.count("\n") == 1 and words in err
