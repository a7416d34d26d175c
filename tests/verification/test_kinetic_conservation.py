"""Mass, momentum and energy over runs of some hundred steps, between periodic sides and walls; order unharmed."""

import numpy as np
import pytest

from tests.verification.free_transport import errors
from tests.verification.kinetic_cases import build, es_bgk, line, orders, run

GRANULAR = {"operator": "granular-es-bgk", "knudsen": 1.0, "restitution": 0.9}
RANDOM = {"state": "random-density", "seed": 3, "low": 0.1, "high": 1.0}
PLANE = {"cells": [10, 8], "lower": [0.0, 0.0], "upper": [1.0, 0.8], "boundary": {"x": "periodic", "y": "periodic"}}
WALLS = {
    "lower": {"kind": "maxwell", "accommodation": 0.6, "temperature": 1.5, "velocity": [0.0, 0.4]},
    "upper": "specular",
}


def balances(job, steps):
    simulation = run(job)
    row = simulation.diagnostics.row
    print({name: row[name] for name in ("step", "mass_error", "momentum_error", "energy_error", "correction", "min_g")})
    assert simulation.number == steps
    return row


@pytest.mark.parametrize("collision", [es_bgk(0.1, 3.0, 1.0, 0.5), GRANULAR], ids=["elastic", "granular"])
@pytest.mark.parametrize("scaling", ["thermal", "kinetic", "macroscopic", "none"])
def test_periodic_gas_of_random_density(scaling, collision):
    job = build(
        space=PLANE,
        velocity={"points": [12, 10], "half_width": 7.0},
        scaling=scaling,
        scheme={"conservative": True},
        collision=collision,
        initial=RANDOM,
        time={"end": 10.0, "max_steps": 300},
    )
    row = balances(job, 300)
    assert abs(row["mass_error"]) <= 1e-13
    assert row["momentum_error"] <= 1e-12
    assert abs(row["energy_error"]) <= 1e-12
    assert row["min_g"] >= 0
    assert (row["dissipated_energy"] > 1e-3) == (collision is GRANULAR)


def test_three_velocity_dimensions():
    job = build(
        space=PLANE,
        velocity={"points": [10, 10, 8], "half_width": [7.0, 7.0, 6.0]},
        collision=GRANULAR,
        initial=RANDOM,
        time={"end": 10.0, "max_steps": 200},
    )
    row = balances(job, 200)
    assert abs(row["mass_error"]) <= 1e-13
    assert row["momentum_error"] <= 1e-12 and abs(row["energy_error"]) <= 1e-12


def test_paper_s_scaling_keeps_mass_alone():
    """Without the correction momentum and energy drift, in this gas by far more than round-off."""
    job = build(
        space=PLANE,
        velocity={"points": [12, 10], "half_width": 7.0},
        scaling="macroscopic",
        scheme={"conservative": False},
        collision=es_bgk(0.1, 3.0, 1.0, 0.5),
        initial=RANDOM,
        time={"end": 10.0, "max_steps": 100},
    )
    row = balances(job, 100)
    assert abs(row["mass_error"]) <= 1e-13
    assert abs(row["energy_error"]) > 1e-6


@pytest.mark.parametrize("scaling", ["thermal", "kinetic", "macroscopic", "none"])
def test_what_enters_through_walls_is_counted(scaling):
    job = build(
        space=line(20, WALLS),
        velocity={"points": [20, 12], "half_width": 7.0},
        scaling=scaling,
        collision=GRANULAR,
        initial={"state": "wave", "density_amplitude": 0.3, "velocity": [0.0, 0.2]},
        time={"end": 10.0, "max_steps": 300},
    )
    row = balances(job, 300)
    assert abs(row["mass_error"]) <= 1e-13
    assert row["momentum_error"] <= 1e-12 and abs(row["energy_error"]) <= 1e-12
    assert abs(row["entered_mass_x-lower"]) <= 1e-13 and abs(row["entered_mass_x-upper"]) <= 1e-13
    assert abs(row["entered_energy_x-lower"]) > 1e-2 and abs(row["entered_momentum_y_x-lower"]) > 1e-3
    assert abs(row["entered_energy_x-upper"]) <= 1e-13 and abs(row["entered_momentum_y_x-upper"]) <= 1e-13


@pytest.mark.parametrize("kind", ["far-field", "outflow", "vacuum"])
def test_what_crosses_open_sides_is_counted(kind):
    job = build(
        space=line(20, kind),
        velocity={"points": [24, 8], "half_width": 7.0},
        collision=es_bgk(0.1),
        initial={"state": "temperature-disc", "radius": 0.2, "inner": 4.0, "outer": 1.0},
        time={"end": 10.0, "max_steps": 200},
    )
    row = balances(job, 200)
    assert abs(row["mass_error"]) <= 1e-13
    assert row["momentum_error"] <= 1e-12 and abs(row["energy_error"]) <= 1e-12
    lost = -sum(row[f"entered_energy_{side}"] for side in ("x-lower", "x-upper"))
    assert abs(lost) > 1e-3


def test_correction_does_not_harm_the_order():
    """Free transport in the paper's scaling, refined in space, velocity and time: with and without the correction."""
    found = {c: [errors(n, n // 2, "macroscopic", c)[0] for n in (32, 64, 128)] for c in (True, False)}
    for conservative, values in found.items():
        print(f"conservative {conservative}: {values}, orders {orders(values).round(2).tolist()}")
        assert orders(values)[-1].min() > 1.7
    assert np.all(np.array(found[True][-1]) < 1.5 * np.array(found[False][-1]))
