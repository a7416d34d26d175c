"""The limit of small Knudsen numbers: whatever the number, down to where doubles end, the result is the limit's."""

import numpy as np
import pytest

from rvm_mpi import Job, Simulation
from rvm_mpi.step.relaxation import DEEPEST

SMALL = (1e-14, 1e-20, 1e-100, 1e-300)


def moments(collision, knudsen, scaling):
    job = Job.from_dict(
        {
            "space": {"cells": [12], "boundary": {"x": "diffuse"}},
            "velocity": {"points": [16, 16]},
            "scaling": {"kind": scaling},
            "collision": {**collision, "knudsen": knudsen},
            "initial": {"state": "wave", "mode": [1], "density_amplitude": 0.3},
            "fluid": {"enabled": True},
            "time": {"end": 0.1},
        }
    )
    simulation = Simulation(job)
    mismatch = [simulation.diagnostics.row["correction"] for _ in simulation]
    return simulation.moments(), max(mismatch)


@pytest.mark.parametrize("scaling", ["kinetic", "macroscopic", "none"])
@pytest.mark.parametrize(
    "collision", [{"operator": "es-bgk"}, {"operator": "boltzmann", "restitution": 1.0, "penalise": True}],
    ids=["es-bgk", "boltzmann"],
)  # fmt: skip
def test_small_knudsen_numbers_agree(collision, scaling):
    limit, correction = moments(collision, SMALL[-1], scaling)
    near, _ = moments(collision, 1e-8, scaling)
    for name in ("density", "velocity", "temperature"):
        assert np.abs(near[name] - limit[name]).max() < 1e-6
    for knudsen in SMALL[:-1]:
        found, mismatch = moments(collision, knudsen, scaling)
        for name, values in found.items():
            assert np.abs(values - limit[name]).max() < 100 / DEEPEST, (name, knudsen)
        assert mismatch == pytest.approx(correction, rel=0.1, abs=1e-9)
