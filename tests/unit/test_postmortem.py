"""What is no number is caught in the step in which it appears, in the cell where it was; what is left of a run."""

import json
import math

import numpy as np
import pytest

from rvm_mpi.job.job import Job
from rvm_mpi.job.text import parse_toml
from rvm_mpi.run import postmortem
from rvm_mpi.run.run import run_job
from rvm_mpi.simulation import Simulation
from rvm_mpi.step.failure import NumericalFailure

GRANULAR = {"operator": "granular-es-bgk", "knudsen": 0.2, "restitution": 0.9}
BOLTZMANN = {"operator": "boltzmann", "knudsen": 0.2, "restitution": 0.95}
PAPER = {"scaling": {"kind": "macroscopic"}, "scheme": {"conservative": False}}
CASES = {
    "granular": {"collision": GRANULAR, "fluid": {"enabled": True}},
    "paper": {"collision": GRANULAR, **PAPER},
    "unscaled": {"collision": {"operator": "none"}, "scaling": {"kind": "none"}, "scheme": {"conservative": False}},
    "boltzmann": {"collision": BOLTZMANN},
    "elastic boltzmann": {"collision": {**BOLTZMANN, "restitution": 1.0}},
    "penalised": {"collision": {**BOLTZMANN, "penalise": True}},
    "paper's boltzmann": {"collision": BOLTZMANN, **PAPER},
}


def make_job(name, cells):
    space = {"cells": list(cells)}
    if len(cells) == 1:
        space["boundary"] = {"x": "diffuse"}
    initial = {"state": "random-density", "low": 0.5} if cells else {"state": "uniform"}
    return Job.from_dict(
        {
            "space": space,
            "velocity": {"points": [12, 10]},
            "initial": initial,
            "time": {"end": 1.0, "max_steps": 5},
            **CASES[name],
        },
        name,
    )


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("cells", [(), (6,), (5, 4)])
@pytest.mark.parametrize("name", list(CASES))
def test_poisoned_g_is_caught_in_the_next_step_and_its_place_named(name, cells, value):
    simulation = Simulation(make_job(name, cells))
    simulation.advance()
    cell = (3, 2)[: len(cells)] + (0, 0)[: 2 - len(cells)]
    blocks = simulation.kinetic.velocity_grid.unpack(simulation.kinetic.inside(simulation.kinetic.g))
    blocks[cell[1], cell[0], 5, 7, 0] = value
    with pytest.raises(NumericalFailure) as caught:
        simulation.advance()
    assert (caught.value.cell, caught.value.node) == (cell, (5, 7))
    assert str(caught.value).startswith(f"g is not a number in cell ({cell[0]}, {cell[1]})")
    assert f"velocity node (5, 7); step 2 from t = {simulation.time:.6g} with dt = " in str(caught.value)
    assert simulation.number == 1
    found = postmortem.examine(simulation, caught.value)
    assert found["where"]["cell"] == cell and found["where"]["velocity_node"] == (5, 7)
    assert len(found["cells"]) == {0: 1, 1: 3, 2: 9}[len(cells)]


def poison_from(step, cell, patch):
    """From this step on g of a cell is no number before it begins."""
    advance = Simulation.advance

    def poisoned(self):
        if self.number + 1 == step:
            (i0, j0), (nx, ny) = self.domain.start, self.domain.local
            if 0 <= cell[0] - i0 < nx and 0 <= cell[1] - j0 < ny:
                self.kinetic.inside(self.kinetic.g)[cell[1] - j0, cell[0] - i0, 7] = math.nan
        return advance(self)

    patch.setattr(Simulation, "advance", poisoned)


def test_the_file(tmp_path, monkeypatch, capsys):
    """Its numbers are those of an undisturbed run; one of an earlier failure is kept."""
    job = make_job("granular", (5, 4))
    undisturbed = Simulation(job)
    for _ in range(2):
        undisturbed.advance()
    poison_from(3, (4, 1), monkeypatch)
    directory = tmp_path / "run"
    assert run_job(job, directory) == 3
    said = capsys.readouterr().err.splitlines()[-1]
    place = "cell (4, 1) at (0.9, 0.375), velocity node (0, 7)"
    assert said.startswith(f"rvm: granular: g is not a number in {place}; step 3 from t = ")
    assert "; last healthy: step 2, t = " in said
    assert said.endswith(f"; more in {directory / 'post-mortem.json'}")
    found = json.loads((directory / "post-mortem.json").read_text())
    assert (found["step"], found["stage"], found["time"]) == (3, 1, undisturbed.time)
    assert found["where"] == {"cell": [4, 1], "position": [0.9, 0.375], "rank": 0, "ranks": 1, "velocity_node": [0, 7]}
    assert Job.from_dict(parse_toml(found["job"], "kept")) == job
    assert found["versions"]["numpy"] == np.__version__
    assert found["checkpoint_step"] is None
    assert found["history"]["step"] == [0, 1, 2]
    assert found["last_step"]["energy"] == undisturbed.diagnostics.row["energy"]
    cells = {tuple(cell["cell"]): cell for cell in found["cells"]}
    assert set(cells) == {(i, j) for i in (3, 4, 0) for j in (0, 1, 2)}  # across the periodic side
    moments = undisturbed.moments()
    for (i, j), cell in cells.items():
        for name in ("density", "velocity", "temperature"):
            np.testing.assert_allclose(cell["start"][name], moments[name][j, i], rtol=1e-12, atol=1e-14)
        assert cell["start"]["omega"] == undisturbed.kinetic.omega[j, i]
    g = undisturbed.kinetic.velocity_grid.unpack(undisturbed.kinetic.inside(undisturbed.kinetic.g))[1, 4, :, :, 0]
    kept = np.array(found["g"]["stage"], dtype=float)
    assert np.argwhere(np.isnan(kept)).tolist() == [[0, 7]]
    assert np.array_equal(kept[1:], g[1:])
    assert found["marginals"]["stage_x"][0] == "nan"
    (directory / "post-mortem.json").rename(tmp_path / "first")
    (directory / "post-mortem.json").write_text("an earlier one")
    monkeypatch.undo()
    poison_from(2, (0, 0), monkeypatch)
    assert run_job(job, directory, overwrite=True, quiet=True) == 3
    assert (tmp_path / "run-old-1" / "post-mortem.json").read_text() == "an earlier one"
    path = postmortem.write(directory, {"what": "another"}, {})
    assert json.loads(path.read_text()) == {"what": "another"}
    assert "g is not a number" in (directory / "post-mortem-1.json").read_text()


def test_the_paper_s_velocity_grid_stays_below_a_megabyte(tmp_path, monkeypatch):
    tables = {
        "space": {"cells": [3, 3]},
        "velocity": {"points": [24, 24, 8]},
        "collision": GRANULAR,
        "initial": {"state": "random-density", "low": 0.5},
        "time": {"end": 1.0, "max_steps": 3},
    }
    poison_from(2, (1, 1), monkeypatch)
    assert run_job(Job.from_dict(tables), tmp_path / "run", quiet=True) == 3
    path = tmp_path / "run" / "post-mortem.json"
    assert np.shape(json.loads(path.read_text())["g"]["stage"]) == (24, 24, 8)
    assert path.stat().st_size < 1e6


def test_a_step_that_collapses_names_the_cell(tmp_path):
    """A cell whose omega jumps by 1e14 turns that fast."""
    simulation = Simulation(make_job("unscaled", (6,)))
    simulation.advance()
    simulation._rate = 1e15
    simulation.kinetic._diagnostics[0, 4, 4] = 1e15
    with pytest.raises(NumericalFailure, match=r"has collapsed to .* in cell \(4, 0\) at \(0.75\)") as e:
        simulation.advance()
    assert e.value.cell == (4, 0)
    assert postmortem.examine(simulation, e.value)["where"]["cell"] == (4, 0)


def test_the_fluid_s_failure_names_the_cell():
    simulation = Simulation(make_job("paper", (5, 4)))
    simulation.advance()
    simulation.fluid.interior[2, 3, -1] = -1.0
    simulation._rate = 1.0
    with pytest.raises(NumericalFailure, match=r"the fluid lost .* in cell \(3, 2\) at \(0.7, 0.625\); step 2") as e:
        simulation.advance()
    found = postmortem.examine(simulation, e.value)
    assert found["where"]["cell"] == (3, 2)
    assert next(c for c in found["cells"] if c["cell"] == (3, 2))["fluid"][-1] == -1.0
