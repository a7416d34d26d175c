"""The time integrator as a table: what any table must obey, and the orders that two of them have."""

import itertools

import numpy as np
import pytest

from rvm_mpi import Job
from rvm_mpi.grid.domain import Domain
from rvm_mpi.step.scheme import EULER, HEUN, weights
from rvm_mpi.step.stepper import KineticStepper

TABLES = {"Euler": EULER, "Heun": HEUN}


@pytest.mark.parametrize("name", TABLES)
def test_what_a_table_must_obey(name):
    """Weights add up for every depth, which keeps equilibria; the first stage's explicit ones know no depth."""
    table = TABLES[name]
    for z in (0.0, 1e-3, 1.0, 7.0, 1e6):
        for stage in table:
            w = weights(stage, z)
            assert w.old + w.new + w.first + w.last == pytest.approx(w.whole, rel=1e-15)
    assert [stage.number for stage in table] == list(range(len(table)))
    assert [stage.final for stage in table] == [False] * (len(table) - 1) + [True]
    assert table[0].new[1:] == table[0].first[1:] == (0.0, 0.0)
    assert table[0].time == 0.0
    # each stage's result counts in the last one's as often as the later ones take it, and rates add up to one step
    for stage, later in itertools.pairwise(table):
        assert stage.reach == later.reach * (1.0 - later.old)
    assert table[-1].reach == 1.0
    assert sum(stage.share for stage in table) == 1.0
    # the same cooling in the step whatever it is taken from
    assert sum(stage.reach * (stage.cooled_before + stage.cooled_after) for stage in table) == 1.0


def stress_error(table, steps):
    """Error of Theta_xx - Theta_yy of a homogeneous gas after one relaxation time, relative to its start."""
    relaxation = {"coefficient": 2.0, "density_power": 1, "temperature_power": 0.5}
    collision = {"operator": "es-bgk", "knudsen": 1.0, "prandtl": 0.7, "relaxation": relaxation}
    job = Job.from_dict(
        {
            "initial": {"state": "uniform"}, "time": {"end": 1.0}, "space": {"cells": []},
            "velocity": {"points": [16, 16], "half_width": 8.0}, "collision": collision,
        }
    )  # fmt: skip
    tensor = np.diag([1.3, 0.7]).reshape(1, 1, 2, 2)
    stepper = KineticStepper(job, Domain(job), np.ones((1, 1)), np.zeros((1, 1, 2)), tensor, integrator=table)
    end = 0.5
    stepper.first_stage(0.0)
    for _ in range(steps):
        stepper.first_stage(end / steps)
        stepper.later_stages(end / steps)
    stress = stepper.fields()["stress"][0, 0]
    # d_t (Theta - T I) = -(1 - nu) tau (Theta - T I)
    exact = 0.6 * np.exp(-2.0 / 0.7 * end)
    assert np.trace(stress) == pytest.approx(2.0, rel=1e-12)
    return abs((stress[0, 0] - stress[1, 1]) / exact - 1.0)


@pytest.mark.parametrize(("name", "order"), [("Euler", 1), ("Heun", 2)])
def test_order_of_the_relaxation(name, order):
    errors = [stress_error(TABLES[name], steps) for steps in (20, 40, 80)]
    found = np.log2(np.array(errors[:-1]) / errors[1:])
    print(f"{name}: errors {errors}, orders {found}")
    assert np.all(np.abs(found - order) < 0.15)
