"""`rvm run` from the command to the files it leaves, and the same loop as a library."""

import json
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
import tomli_w
from small_runs import contents

from rvm_mpi import Simulation
from rvm_mpi.commands.main import main
from rvm_mpi.job.job import Job
from rvm_mpi.output import rundir
from rvm_mpi.results import open_run, read_history

JOB = {
    "title": "tiny",
    "space": {"cells": [6, 5], "boundary": {"y": "diffuse"}},
    "velocity": {"points": [8, 8, 8]},
    "collision": {"operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.9},
    "fluid": {"enabled": True},
    "initial": {"state": "random-density", "seed": 2, "low": 0.5},
    "time": {"end": 0.03},
    "output": {"times": [0.0, 0.0123, 0.03], "marginals": True},
}
COOLING = {
    "space": {"cells": []},
    "velocity": {"points": [8, 8, 8]},
    "collision": {"operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.8},
    "initial": {"state": "uniform", "velocity": [0.5, 0.0, 0.0]},
    "time": {"end": 20.0},
}
FILES = {"job.toml", "fields.h5", "fields.xdmf", "history.csv", "run.log"}


def write(directory, job, name="tiny"):
    path = directory / f"{name}.toml"
    path.write_text(tomli_w.dumps(job))
    return path


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run in a directory of its own: (place, run directory, the process)."""
    place = tmp_path_factory.mktemp("run")
    write(place, JOB)
    done = subprocess.run(
        [sys.executable, "-m", "rvm_mpi", "run", "tiny.toml"], cwd=place, capture_output=True, text=True, timeout=250
    )
    assert done.returncode == 0, done.stderr
    return place, place / "runs" / "tiny", done


@pytest.mark.timeout(400)
def test_the_files_of_a_run(finished):
    _place, run, done = finished
    names = {path.name for path in run.iterdir()}
    assert names >= FILES
    assert all(name.startswith("checkpoint-") for name in names - FILES)
    assert done.stdout == ""
    assert "100" in done.stderr.splitlines()[-2] + done.stderr.splitlines()[-1]
    log = (run / "run.log").read_text()
    for word in ("version", "ranks", "numba", "started"):
        assert word in log


def test_the_job_is_kept_with_every_default(finished):
    place, run, _done = finished
    assert Job.from_file(run / "job.toml") == Job.from_file(place / "tiny.toml")
    assert "cfl = 0.5" in (run / "job.toml").read_text()


def test_fields(finished):
    _place, run, _done = finished
    found = open_run(run)
    assert found.time.values.tolist() == [0.0, 0.0123, 0.03]  # hit exactly
    assert found.attrs["title"] == "tiny"
    with h5py.File(run / "fields.h5") as file:
        shapes = {name: file[name].shape for name in ("kinetic/density", "kinetic/stress", "marginal/x")}
        assert shapes == {
            "kinetic/density": (3, 5, 6),
            "kinetic/stress": (3, 5, 6, 3, 3),
            "marginal/x": (3, 5, 6, 8),
        }
        assert {"x", "y", "kinetic/heat_flux", "kinetic/velocity", "scaling/omega", "fluid/density"} <= set(names(file))
        assert "wall/y-lower/pressure" in file and "wall/x-lower/pressure" not in file
        t = file["kinetic/temperature"][...]
        np.testing.assert_allclose(t, np.trace(file["kinetic/stress"][...], axis1=-2, axis2=-1) / 3, rtol=1e-14)
        np.testing.assert_allclose(file["kinetic/temperature"][0], 1.0, rtol=1e-12)
        # the marginal of g integrates to the density
        h = 2 * 7.0 / 8
        np.testing.assert_allclose(file["marginal/x"][...].sum(axis=-1) * h, file["kinetic/density"][...], rtol=1e-11)


def names(file):
    found = []
    file.visit(found.append)
    return found


def test_history(finished):
    _place, run, _done = finished
    history = read_history(run)
    columns = list(history)
    first = ["step", "time", "dt", "mass", "momentum_x", "momentum_y", "momentum_z", "energy", "fluid_energy"]
    assert columns[: len(first)] == first
    sides = [f"entered_{part}_y-{end}" for end in ("lower", "upper") for part in ("mass", "momentum_x", "energy")]
    more = ["dissipated_energy", "mean_temperature", "min_g", "max_g", "correction", "gaussians_replaced", *sides]
    assert set(more) <= set(columns)
    assert not any("x-lower" in name for name in columns)
    steps = history["step"]
    assert np.array_equal(steps, np.arange(len(steps))) and len(steps) > 5
    assert {0.0, 0.0123, 0.03} <= set(history["time"])
    np.testing.assert_allclose(np.diff(history["time"]), history["dt"][1:], rtol=1e-12)
    assert np.abs(history["mass_error"]).max() < 1e-13
    assert np.abs(history["energy_error"]).max() < 1e-12
    assert history["dissipated_energy"][-1] > 0.0
    assert np.all(np.isfinite([history[name] for name in columns]))
    # what entered through diffuse walls is no mass
    entered = np.abs([history[f"entered_mass_y-{end}"] for end in ("lower", "upper")])
    assert entered.max() < 1e-15
    with h5py.File(run / "fields.h5") as file:
        mass = file["kinetic/density"][-1].sum() / 30
    assert mass == pytest.approx(history["mass"][-1], rel=1e-14)


def test_a_run_is_not_overwritten(finished, capsys):
    place, run, _done = finished
    before = contents(place)
    assert main(["run", str(place / "tiny.toml"), "--output", str(run)]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert "holds a run already" in captured.err
    assert contents(place) == before


def test_overwrite_moves_aside_set_overrides_and_quiet_is_quiet(finished, tmp_path, capfd):
    place, run, _done = finished
    target = tmp_path / "again"
    target.mkdir()
    for path in run.iterdir():
        (target / path.name).write_bytes(path.read_bytes())
    arguments = ["run", str(place / "tiny.toml"), "--output", str(target), "--overwrite", "--quiet"]
    assert main([*arguments, "--set", "collision.restitution=0.5", "--set", "time.max_steps=2"]) == 0
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "")
    assert Job.from_file(target / "job.toml").collision.restitution == 0.5
    assert read_history(target)["step"].tolist() == [0, 1, 2]
    assert open_run(target).time.values.tolist() == [0.0, read_history(target)["time"][-1]]
    assert contents(tmp_path / "again-old-1") == contents(run)
    assert "again-old-1" in (target / "run.log").read_text()


def test_the_same_command_gives_the_same_bits(finished, tmp_path):
    """A second run, with kernels from the cache, in this process: not a bit differs."""
    place, run, _done = finished
    assert main(["run", str(place / "tiny.toml"), "--output", str(tmp_path / "again"), "--quiet"]) == 0
    assert (tmp_path / "again" / "history.csv").read_bytes() == (run / "history.csv").read_bytes()
    with h5py.File(run / "fields.h5") as one, h5py.File(tmp_path / "again" / "fields.h5") as two:
        for name in names(one):
            if isinstance(one[name], h5py.Dataset):
                assert one[name][...].tobytes() == two[name][...].tobytes(), name


def test_info_of_a_run(finished, capsys):
    _place, run, _done = finished
    assert main(["info", str(run)]) == 0
    out = capsys.readouterr().out
    for words in ("tiny: random-density", "(100.0 %)", "3: t = 0, 0.0123, 0.03", "all numbers finite"):
        assert words in out


def test_a_gas_too_cold_for_its_grid_fails_in_one_line(tmp_path, capsys):
    """A moving gas cools, T_g = 1 - |u|^2/d/omega^2 shrinks below what eight points resolve."""
    job, run = write(tmp_path, COOLING, "cooling"), tmp_path / "out"
    assert main(["run", str(job), "--output", str(run), "--quiet"]) == 3
    captured = capsys.readouterr()
    lines = (run / "run.log").read_text().splitlines()
    assert lines[-2].startswith("rvm: cooling: ")
    assert lines[-1] == lines[-2].replace("rvm: cooling: ", "ended: failed: ")
    assert captured.err == lines[-2] + "\n"  # --quiet does not hide a failure
    assert "T_g is below what its spacing resolves in cell (0, 0); step" in lines[-1]
    assert captured.out == ""
    history = read_history(run)
    assert 0.1 < history["time"][-1] < 20.0
    assert np.all(np.isfinite(history["energy"]))
    assert rundir.holds_run(run)


def test_a_state_that_does_not_fit_the_grid(tmp_path, capsys):
    job = {**JOB, "initial": {"state": "uniform", "velocity": [9.0, 0.0, 0.0]}}
    path = write(tmp_path, job)
    assert main(["run", str(path), "--output", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1 and "velocity.points" in captured.err
    assert not (tmp_path / "out").exists()


@pytest.mark.timeout(200)
def test_too_many_ranks_end_at_once_on_all(mpirun, tmp_path):
    job = {**JOB, "space": {"cells": [6]}}
    write(tmp_path, job)
    start = time.monotonic()
    done = mpirun(4, "-m", "rvm_mpi", "run", "tiny.toml", cwd=tmp_path, timeout=60)
    assert done.returncode == 2
    assert time.monotonic() - start < 30.0
    ours = [line for line in done.stderr.splitlines() if line.startswith("rvm: ")]
    assert len(ours) == 1  # rank 0 speaks
    assert "4 ranks cannot share 6" in ours[0] and "below is 2" in ours[0]
    assert "Traceback" not in done.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"tiny.toml"}


@pytest.mark.timeout(300)
def test_bench_prints_json(capsys):
    assert main(["bench", "--cells", "8", "8", "--velocity", "8", "8", "8", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["cells"], found["velocity"], found["ranks"]) == ([8, 8], [8, 8, 8], 1)
    for name in ("triad_ns", "gflops", "stage_ns", "uncorrected_ns", "step_ns", "stage_per_triad", "cells_per_second"):
        assert found[name] > 0.0


def test_the_loop_as_a_library():
    """A state from a function of x and y, one step each, moments on this rank."""

    def state(x, y):
        density = 1.0 + 0.2 * np.cos(2 * np.pi * x) * np.cos(2 * np.pi * y)
        return density, np.array([0.1, 0.0, 0.0]), 1.0 / density

    job = Job.from_dict({**JOB, "space": {"cells": [6, 5]}, "output": {}, "time": {"end": 0.02}})
    simulation = Simulation(job, initial=state)
    before = simulation.moments()
    x = (np.arange(6) + 0.5)[None, :] / 6
    y = (np.arange(5) + 0.5)[:, None] / 5
    wanted, velocity, temperature = state(x, y)
    np.testing.assert_allclose(before["density"], wanted, rtol=1e-13)
    np.testing.assert_allclose(before["velocity"], np.broadcast_to(velocity, (5, 6, 3)), atol=1e-11)
    np.testing.assert_allclose(before["temperature"], temperature, rtol=1e-11)
    elapsed, numbers = 0.0, []
    for step in simulation:
        elapsed += step.dt
        numbers.append(step.number)
        assert step.time == pytest.approx(elapsed)
        assert step.limit
    assert numbers == list(range(1, len(numbers) + 1)) and len(numbers) > 2
    assert simulation.time == 0.02
    after = simulation.moments()
    assert after["density"].sum() == pytest.approx(before["density"].sum(), rel=1e-14)
    assert np.abs(after["density"] - before["density"]).max() > 1e-4
    with pytest.raises(ValueError, match="no positive, finite density and temperature"):
        Simulation(job, initial=lambda x, y: (x - 0.5, [0.0, 0.0, 0.0], 1.0))


def test_the_example_of_the_readme_runs(tmp_path, monkeypatch):
    """A job file by relative path, the default run directory."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path, {**JOB, "time": {"end": 0.03, "max_steps": 1}, "output": {}})
    assert main(["run", "tiny.toml", "--quiet"]) == 0
    assert rundir.holds_run(Path("runs/tiny"))
