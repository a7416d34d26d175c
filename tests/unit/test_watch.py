"""Warnings and stops of a run: the outermost velocities and the balances."""

import numpy as np
import pytest

from rvm_mpi.commands.main import main
from rvm_mpi.job.job import Job
from rvm_mpi.output import checkpoint
from rvm_mpi.results import read_history
from rvm_mpi.run import watch
from rvm_mpi.run.run import run_job
from rvm_mpi.simulation import Simulation

TABLES = {
    "space": {"cells": [6], "boundary": {"x": "diffuse"}},
    "velocity": {"points": [12, 10], "half_width": [7.0, 6.0]},
    "collision": {"operator": "es-bgk", "knudsen": 0.2},
    "initial": {"state": "wave", "density_amplitude": 0.3, "temperature_amplitude": 0.4},
    "time": {"end": 1.0, "max_steps": 6},
}


def make_job(**tables):
    return Job.from_dict({**TABLES, **tables}, "watched")


def shares(simulation):
    """Largest shares of mass and energy in the outermost velocities, from g node by node."""
    kinetic, worst = simulation.kinetic, [0.0, 0.0]
    grid = kinetic.velocity_grid
    for row in grid.unpack(kinetic.inside(kinetic.g)):
        for block in row:
            total, outer = np.zeros(2), np.zeros(2)
            for node in np.ndindex(block.shape):
                speed2 = sum(grid.nodes[q, node[q]] ** 2 for q in range(grid.dimensions))
                part = block[node] * np.array([1.0, speed2])
                total += part
                if any(node[q] in (0, grid.points[q] - 1) for q in range(grid.dimensions)):
                    outer += part
            worst = np.maximum(worst, outer / total)
    return worst


@pytest.mark.parametrize("tables", [{}, {"space": {"cells": []}, "initial": {"state": "uniform"}},
                                    {"space": {"cells": [4, 3]}, "velocity": {"points": [8, 7, 6], "half_width": 4.0}}])
def test_the_columns_are_the_shares_of_the_outermost_nodes(tables):
    simulation = Simulation(make_job(**tables))
    for _ in range(3):
        row = simulation.diagnostics.row
        np.testing.assert_allclose([row["box_mass"], row["box_energy"]], shares(simulation), rtol=1e-10)
        simulation.advance()
    assert 0.0 < row["box_mass"] < row["box_energy"] < 1.0


def test_a_warning_once_and_again_when_it_has_grown_by_ten():
    watched = watch.Watch(make_job(watch={"box_warning": 0.01}))
    quiet = dict.fromkeys(("mass_error", "momentum_error", "energy_error", "box_mass"), 0.0)
    said = []
    for step, share in enumerate([0.001, 0.01, 0.011, 0.05, 0.1, 0.12, 0.005, 0.5, 1.3]):
        row = {**quiet, "box_energy": share, "step": step, "time": 0.5 * step}
        said += [(step, line) for line in watched.warnings(row)]
    assert [step for step, _ in said] == [2, 5, 8]
    what = "the outermost velocities hold 0.011 of some cell's energy in step 2 at t = 1"
    assert said[0][1] == f"{what}{watch._CURE}"
    assert "wider velocity.half_width" in said[0][1] and "more velocity.points" in said[0][1]


@pytest.mark.parametrize("conservative", [True, False])
def test_balances_are_watched_where_they_are_promised(conservative):
    job = make_job(scaling={"kind": "macroscopic"}, scheme={"conservative": conservative}, watch={"balance": 1e-9})
    row = {"mass_error": -2e-9, "momentum_error": 1e-8, "energy_error": -3e-9, "box_mass": 0.0, "box_energy": 0.0}
    lines = watch.Watch(job).warnings({**row, "step": 3, "time": 0.25})
    words = "the balance of mass is off by 2e-09 of what there was and what came through the sides"
    assert lines[0] == f"{words} in step 3 at t = 0.25"
    assert len(lines) == (3 if conservative else 1)
    assert watch.Watch(job).warnings({**dict.fromkeys(row, 0.9e-9), "step": 3, "time": 0.25}) == []


def test_between_open_sides_a_balance_is_relative_to_what_came_through():
    job = make_job(watch={"balance": 1e-9})
    row = {"mass_error": 2e-8, "momentum_error": 0.0, "energy_error": -3e-8, "box_mass": 0.0, "box_energy": 0.0}
    row |= {"mass": 2.0, "energy": 8.0, "step": 3, "time": 0.25}
    through = {"entered_mass_x-lower": 30.0, "entered_mass_x-upper": -28.0, "entered_energy_x-lower": -80.0}
    lines = watch.Watch(job).warnings({**row, **through, "entered_momentum_x_x-lower": 1e9})
    assert [line.split(" is off")[0] for line in lines] == ["the balance of energy"]
    assert f"off by {3e-8 / 11:.2g} of" in lines[0]


def test_a_run_whose_gas_is_lost_says_so(tmp_path, capsys, monkeypatch):
    """A hundredth of a millionth of one cell's mass is taken away before step 3."""
    advance = Simulation.advance

    def leaking(self):
        if self.number == 2:
            self.kinetic.now.carried[0, 3] *= 1.0 - 1e-8
        return advance(self)

    monkeypatch.setattr(Simulation, "advance", leaking)
    assert run_job(make_job(), tmp_path / "run") == 0
    warnings = [line for line in capsys.readouterr().err.splitlines() if "warning" in line]
    mass = read_history(tmp_path / "run")["mass_error"]
    assert abs(mass[2]) < 1e-14 and 1e-10 < -mass[3] < 1e-8
    assert [line for line in warnings if "of mass is off" in line] == [
        f"rvm: watched: warning: the balance of mass is off by {-mass[3]:.2g} of what there was and what came through "
        f"the sides in step 3 at t = {read_history(tmp_path / 'run')['time'][3]:.6g}"
    ]
    assert all(line in (tmp_path / "run" / "run.log").read_text() for line in warnings)


def test_a_sound_run_says_nothing(tmp_path, capsys):
    assert run_job(make_job(), tmp_path / "run") == 0
    assert "warning" not in capsys.readouterr().err


def test_a_stop_at_the_box_with_a_checkpoint_and_going_on(tmp_path, capsys):
    """A box of two thermal speeds: the run ends in its first step, and goes on where it may."""
    tables = {"velocity": {"points": [12, 10], "half_width": 3.0}, "watch": {"box_stop": 0.01}}
    directory = tmp_path / "run"
    assert run_job(make_job(**tables), directory) == 3
    lines = capsys.readouterr().err.splitlines()
    assert "warning: the outermost velocities hold" in lines[0]
    last = lines[-1]
    assert last.startswith("rvm: watched: stopped after step 1 at t = ")
    assert "of some cell's energy, above watch.box_stop = 0.01" in last or "of some cell's mass, above" in last
    assert "the checkpoint of step 1 is there for --restart with another watch.box_stop" in last
    assert [path.name for path in directory.glob("checkpoint*")] == ["checkpoint-00000001.h5"]
    options = ["run", str(directory / "job.toml"), "--output", str(directory), "--restart", "--quiet"]
    assert main([*options, "--set", "watch.box_stop=1.0"]) == 0
    whole = make_job(**{**tables, "watch": {}})
    assert run_job(whole, tmp_path / "whole", quiet=True) == 0
    assert (tmp_path / "whole" / "history.csv").read_bytes() == (directory / "history.csv").read_bytes()
    assert checkpoint.rundir.checkpoints(directory)[-1].name == "checkpoint-00000006.h5"


def test_a_job_is_checked_with_what_it_will_watch(tmp_path, capsys):
    path = tmp_path / "job.toml"
    path.write_text(make_job().to_toml())
    assert main(["check", str(path), "--set", "watch.box_stop=0.05"]) == 0
    printed = capsys.readouterr().out.splitlines()
    lines = [line for line in printed if "warning above" in line]
    assert lines[0].endswith("outermost velocities: a warning above 0.001 of a cell's gas, a stop above 0.05")
    assert lines[1].endswith("mass, momentum, energy: a warning above 1e-10, relative")


def test_a_threshold_of_one_is_never_passed():
    """A g that is negative in places can hold more than all of a cell's energy in the outermost velocities."""
    row = dict.fromkeys(("mass_error", "momentum_error", "energy_error", "box_mass"), 0.0)
    row.update(box_energy=1.3, step=1, time=0.5)
    never = watch.Watch(make_job(watch={"box_warning": 1.0, "box_stop": 1.0}))
    assert never.reason_to_stop(row) == "" and never.warnings(row) == []
    assert watch.Watch(make_job(watch={"box_stop": 0.99})).reason_to_stop(row)


def test_a_negative_share_counts_by_its_size():
    """Linear reconstructions leave g negative in the outermost velocities: the share is then below zero."""
    row = dict.fromkeys(("mass_error", "momentum_error", "energy_error", "box_mass"), 0.0)
    row.update(box_energy=-0.3, step=1, time=0.5)
    watched = watch.Watch(make_job(watch={"box_warning": 0.1, "box_stop": 0.2}))
    assert watched.reason_to_stop(row) == "the outermost velocities hold 0.3 of some cell's energy, above " \
        "watch.box_stop = 0.2"
    assert len(watched.warnings(row)) == 1
    assert watched.reason_to_stop({**row, "box_energy": -0.1}) == ""


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_cell_with_less_than_nothing_outside_stops_a_run(tmp_path, capsys, monkeypatch, sign):
    """One cell's outermost velocities are given a two-hundredth of its mass, or lose as much, before step 2."""
    advance = Simulation.advance

    def disturbed(self):
        if self.number == 1:
            kinetic = self.kinetic
            block = kinetic.velocity_grid.unpack(kinetic.inside(kinetic.g)[0, 2])
            block[0] += sign * 0.005 * block.sum() / block[0].size
        return advance(self)

    monkeypatch.setattr(Simulation, "advance", disturbed)
    job = make_job(watch={"box_stop": 0.001}, collision={"operator": "none"}, scheme={"conservative": False},
                   scaling={"kind": "none"}, velocity={"points": [12, 10], "half_width": [8.0, 7.0]})  # fmt: skip
    assert run_job(job, tmp_path / "run") == 3
    assert "stopped after step 2 at" in capsys.readouterr().err
