"""The run directory: an old run is never lost, and nothing is written when a request is refused."""

from pathlib import Path

import pytest

from rvm_mpi.job.job import Job, JobError
from rvm_mpi.output import rundir

JOB = Job.from_dict(
    {
        "space": {"cells": [8]},
        "velocity": {"points": [8]},
        "collision": {"operator": "none"},
        "initial": {"state": "uniform"},
        "time": {"end": 1.0},
    }
)


def contents(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}


@pytest.fixture
def old_run(tmp_path):
    path = tmp_path / "run-e0.75"
    rundir.prepare(path, JOB)
    (path / "fields.h5").write_bytes(b"precious")
    (path / "checkpoint-000001.h5").write_bytes(b"state")
    return path


def test_a_new_directory_gets_the_job_with_its_defaults(tmp_path):
    path = tmp_path / "a" / "b"
    assert rundir.prepare(path, JOB) is None
    assert Job.from_file(path / "job.toml") == JOB
    assert contents(path).keys() == {"job.toml"}


def test_an_empty_or_unrelated_directory_is_taken(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    rundir.prepare(tmp_path, JOB)
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("mark", [*rundir.MARKS, "checkpoint-12.h5"])
def test_a_directory_with_any_part_of_a_run_is_refused(tmp_path, mark):
    (tmp_path / mark).write_bytes(b"x")
    before = contents(tmp_path)
    with pytest.raises(JobError, match="holds a run already"):
        rundir.prepare(tmp_path, JOB)
    assert contents(tmp_path) == before


def test_overwrite_moves_the_old_run_aside_each_time(old_run):
    before = contents(old_run)
    first = rundir.prepare(old_run, JOB, overwrite=True)
    assert first == old_run.with_name("run-e0.75-old-1")
    assert contents(first) == before
    (old_run / "fields.h5").write_bytes(b"second")
    second = rundir.prepare(old_run, JOB, overwrite=True)
    assert second == old_run.with_name("run-e0.75-old-2")
    assert contents(first) == before
    assert (second / "fields.h5").read_bytes() == b"second"
    assert contents(old_run).keys() == {"job.toml"}


def test_overwrite_of_the_directory_one_stands_in(old_run, monkeypatch):
    monkeypatch.chdir(old_run)
    aside = rundir.prepare(Path(), JOB, overwrite=True)
    assert aside == old_run.with_name("run-e0.75-old-1")
    assert (aside / "fields.h5").read_bytes() == b"precious"
    assert contents(old_run).keys() == {"job.toml"}


def test_overwrite_through_a_link_stays_on_the_linked_disk(old_run, tmp_path):
    link = tmp_path / "link"
    link.symlink_to(old_run)
    aside = rundir.prepare(link, JOB, overwrite=True)
    assert (aside / "fields.h5").read_bytes() == b"precious"
    assert link.is_symlink()
    assert contents(old_run).keys() == {"job.toml"}


def test_restart_keeps_everything(old_run):
    before = contents(old_run)
    assert rundir.prepare(old_run, JOB, restart=True) is None
    assert contents(old_run) == before


def test_restart_may_go_further_and_keeps_the_older_job(old_run):
    before = contents(old_run)
    longer = Job.from_file(old_run / "job.toml", ["time.end=2.0"])
    rundir.prepare(old_run, longer, restart=True)
    assert Job.from_file(old_run / "job.toml") == longer
    assert (old_run / "job-1.toml").read_bytes() == before["job.toml"]


def test_restart_as_another_problem_is_refused(old_run):
    before = contents(old_run)
    other = Job.from_file(old_run / "job.toml", ["space.cells=[16]"])
    with pytest.raises(JobError, match=r"space\.cells is \[16\], was \[8\]; only time"):
        rundir.prepare(old_run, other, restart=True)
    assert contents(old_run) == before


def test_restart_needs_a_run_with_a_checkpoint(tmp_path, old_run):
    with pytest.raises(JobError, match="holds no run"):
        rundir.check(tmp_path / "nothing", restart=True)
    (old_run / "checkpoint-000001.h5").unlink()
    with pytest.raises(JobError, match="no checkpoint"):
        rundir.check(old_run, restart=True)


def test_restart_and_overwrite_exclude_each_other(old_run):
    with pytest.raises(JobError, match="exclude"):
        rundir.check(old_run, restart=True, overwrite=True)


def test_a_file_in_the_way(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(JobError, match="not a directory"):
        rundir.check(tmp_path / "file")
    with pytest.raises(JobError, match="not a directory"):
        rundir.check(tmp_path / "file" / "run")


def test_provenance_says_what_produced_the_run():
    facts = rundir.provenance(ranks=3)
    assert facts["ranks"] == "3"
    assert all(isinstance(value, str) and value and "\n" not in value for value in facts.values())
    import numpy

    assert facts["numpy"] == numpy.__version__
    assert facts["git_commit"] == "unknown" or len(facts["git_commit"].split("-")[0]) == 40
