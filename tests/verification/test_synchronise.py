"""The paper's scaling with its automatic synchronisation: a gas that cools by conduction alone, which Euler has not.

Walls of a tenth of the gas's temperature cool it down to theirs; the end is known. Without synchronisation the fluid
keeps a temperature of its own, its omega with it, and the gas is not resolved.
"""

import numpy as np

from tests.verification.kinetic_cases import build, es_bgk, line, run

WALL = 0.1


def cold_walls(synchronise):
    """Moments of f and the last row of the history at t = 20."""
    job = build(
        space=line(12, {"kind": "maxwell", "temperature": WALL}),
        velocity={"points": [16]},
        scaling={"kind": "macroscopic", "synchronise": synchronise},
        scheme={"conservative": False, "drift": "van-leer"},
        collision=es_bgk(0.3, 1.0, 1.0, 0.5),
        initial={"state": "uniform"},
        time={"end": 20.0},
    )
    simulation = run(job)
    return simulation.moments(), simulation.diagnostics.row


def test_without_it_the_gas_stays_too_hot_and_leaves_its_velocity_box():
    moments, row = cold_walls(0.0)
    assert moments["temperature"].max() > 2 * WALL
    assert np.ptp(moments["density"]) > 0.2
    assert row["box_energy"] > 1e-2


def test_with_it_the_gas_comes_to_rest_at_the_walls_temperature():
    moments, row = cold_walls("auto")
    assert np.abs(moments["density"] - 1.0).max() < 1e-2
    assert np.abs(moments["temperature"] / WALL - 1.0).max() < 1e-2
    assert np.abs(moments["velocity"]).max() < 1e-2 * np.sqrt(WALL)
    assert row["box_energy"] < 1e-6
