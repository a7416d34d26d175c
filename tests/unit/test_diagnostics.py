"""The table of columns: what a history holds, what is written about it, what `rvm compare` makes of it."""

import numpy as np
import pytest
from conftest import ROOT

from rvm_mpi import Job, Simulation, diagnostics
from rvm_mpi.diagnostics import COLUMNS, Column, column_named, natural_unit
from rvm_mpi.measure import MEAN

TABLES = {
    "space": {"cells": [4, 3], "boundary": {"x": "specular"}},
    "velocity": {"points": [12, 10]},
    "collision": {"operator": "es-bgk", "knudsen": 0.2},
    "initial": {"state": "wave", "density_amplitude": 0.3},
    "time": {"end": 1.0, "max_steps": 2},
}


def test_the_page_on_the_history_is_the_table():
    page = ROOT / "docs" / "history.md"
    assert page.read_text(encoding="utf-8") == "\n".join(diagnostics.describe()) + "\n"


def test_a_history_has_the_columns_of_the_table_in_their_order():
    simulation = Simulation(Job.from_dict(TABLES))
    templates = [column_named(name) for name in simulation.diagnostics.columns]
    assert list(dict.fromkeys(templates)) == list(COLUMNS)
    names = simulation.diagnostics.columns
    through = [f"entered_{part}_x-{end}" for end in ("lower", "upper") for part in
               ("mass", "momentum_x", "momentum_y", "energy")]  # fmt: skip
    assert [name for name in names if name.startswith("entered")] == through
    row = simulation.diagnostics.row
    assert [name for name in names if np.isnan(row[name])] == [column.name for column in COLUMNS if column.fluid]


def test_a_column_is_one_row(monkeypatch):
    """It needs nothing else: here the mean temperature of the cells, each counted once."""
    column = Column("cell_temperature", MEAN, lambda here: here.temperature, "temperature", "mean over the cells")
    monkeypatch.setattr(diagnostics, "COLUMNS", (*COLUMNS, column))
    simulation = Simulation(Job.from_dict(TABLES))
    for _ in simulation:
        mean = simulation.moments()["temperature"].mean()
        assert simulation.diagnostics.row["cell_temperature"] == pytest.approx(mean, rel=1e-13)
    assert simulation.diagnostics.columns[-1] == "cell_temperature"


def test_natural_units():
    largest = {"mass": 4.0, "energy": 9.0, "max_g": 0.5}
    expected = {
        "momentum_y": 6.0, "entered_momentum_z_y-upper": 6.0, "entered_mass_x-lower": 4.0, "dissipated_energy": 9.0,
        "momentum_error": 1.0, "box_energy": 1.0, "min_g": 0.5, "mass": 0.0, "time": 0.0, "unknown": 0.0,
    }  # fmt: skip
    assert {name: natural_unit(name, largest) for name in expected} == expected
    assert natural_unit("momentum_x", {}) == 0.0


@pytest.mark.timeout(300)
def test_the_same_sums_on_every_rank(mpirun):
    """Also where only some ranks touch a side, or have nothing to add."""
    code = f"""
from rvm_mpi import Job, Simulation
simulation = Simulation(Job.from_dict({TABLES | {"space": {"cells": [3, 8], "boundary": {"y": "diffuse"}}}!r}))
for _ in simulation:
    pass
rows = simulation.domain.comm.gather(repr(simulation.diagnostics.row))
if rows:
    print("\\n".join(set(rows)))
"""
    said = []
    for ranks in (1, 2):
        done = mpirun(ranks, "-c", code, timeout=240, env={"PYTHONPATH": str(ROOT)})
        assert done.returncode == 0, done.stderr
        said.append(done.stdout)
    assert said[0] == said[1] and said[0].count("\n") == 1
