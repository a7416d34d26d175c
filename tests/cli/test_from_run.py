"""A run that begins from another: once it has begun it needs the other no longer, nor a place to be called from."""

import shutil
import subprocess
import sys

import pytest
from conftest import ROOT
from small_runs import job_text

from rvm_mpi.commands.main import main
from rvm_mpi.results import read_history

SHARED = {"space": {"cells": [8], "boundary": {"x": "diffuse"}}, "velocity": {"points": [10, 8]},
          "time": {"end": 0.2, "max_steps": 3}}  # fmt: skip


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A finished run `base`, and `next` that began from it."""
    monkeypatch.chdir(tmp_path)
    base = job_text(**SHARED, initial={"state": "uniform", "temperature": 2.0}, output={"every": 0.1})
    (tmp_path / "base.toml").write_text(base)
    (tmp_path / "next.toml").write_text(job_text(**SHARED, initial={"state": "from-run", "run": "base"}))
    assert main(["run", "base.toml", "--output", "base", "--quiet"]) == 0
    assert main(["run", "next.toml", "--output", "next", "--quiet"]) == 0
    shutil.copytree("next", "copy")
    return tmp_path


def test_a_run_needs_no_longer_what_it_began_from(place, capsys):
    (place / "base").rename("moved")
    more = ["--output", "next", "--restart", "--quiet", "--set"]
    assert main(["run", "next.toml", *more, "time.max_steps=5"]) == 0
    assert main(["run", "next/job.toml", *more, "time.max_steps=6"]) == 0
    assert read_history("next")["step"].tolist() == list(range(7))
    assert main(["compare", "copy", "copy"]) == 0
    assert main(["compare", *(str(max(place.glob("next/checkpoint-*"))),) * 2]) == 0
    assert main(["info", "next"]) == 0
    assert main(["check", "next/job.toml"]) == 0
    out = capsys.readouterr().out
    assert "initial state         the run it came from is gone" in out
    plot = [sys.executable, str(ROOT / "postprocess" / "history.py"), "next"]
    assert subprocess.run(plot, capture_output=True, timeout=120).returncode == 0
    # but none can begin from it
    for command in (["check", "next.toml"], ["run", "next.toml"], ["run", "next/job.toml", "--output", "other"]):
        capsys.readouterr()
        assert main(command) == 2
        captured = capsys.readouterr()
        assert captured.err.startswith(f"rvm: {command[1]}: initial.run: no such directory: {place}/base (allowed")
        assert captured.err.count("\n") == 1
    assert not (place / "other").exists()
    assert not (place / "runs").exists()
    (place / "base").mkdir()
    assert main(["check", "next.toml"]) == 2
    assert f"initial.run: holds no run: {place}/base has no fields.h5" in capsys.readouterr().err
    assert main(["check", "next.toml", "--set", 'initial.run="moved"']) == 0
    assert main(["check", "next.toml", "--set", 'initial.run="gone"']) == 2
    assert capsys.readouterr().err.endswith("[from --set]\n")
    # moved, or on a disk of another name: still the same job
    assert main(["run", "next.toml", *more, 'initial.run="moved"']) == 0


def test_a_job_means_the_same_from_everywhere(place, monkeypatch):
    (place / "sub").mkdir()
    monkeypatch.chdir(place / "sub")
    assert main(["run", "../next.toml", "--output", "fresh", "--quiet"]) == 0
    assert main(["compare", "fresh", "../next"]) == 0
    options = ["--output", "../next", "--restart", "--quiet", "--set", "time.max_steps=5"]
    assert main(["run", "../next.toml", *options]) == 0
    assert read_history("../next")["step"].tolist() == list(range(6))
