"""Free transport against its exact solution, in classical and in rescaled velocities."""

import numpy as np
import pytest

from rvm_mpi import Simulation
from tests.verification.free_transport import errors
from tests.verification.kinetic_cases import build, orders

CASES = {
    # scaling, conservative, drift: ceilings of the L1 errors of density, velocity, temperature on the finest grid
    ("none", False, "van-leer"): (3.5e-6, 7.0e-6, 1.4e-5),
    ("none", True, "van-leer"): (3.5e-6, 7.0e-6, 1.4e-5),
    ("macroscopic", False, "van-leer"): (2.4e-4, 5.5e-4, 4.0e-3),
    ("macroscopic", True, "van-leer"): (1.6e-4, 7.0e-4, 2.7e-3),
    ("kinetic", True, "van-leer"): (1.5e-4, 6.5e-4, 2.6e-3),
}


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c[0]}-{c[2]}{'-conservative' if c[1] else ''}")
def test_second_order_in_space_velocity_and_time_together(case):
    found = [errors(n, n // 2, *case)[0] for n in (32, 64, 128)]
    rates = orders(found)
    print(f"{case}: errors {found}, orders {rates.round(2).tolist()}")
    assert rates[-1].min() > 1.7
    assert all(error < ceiling for error, ceiling in zip(found[-1], CASES[case]))


def test_third_order_in_space():
    """Without scaling, velocities enough and the error of time small: what is left is that of the cells."""
    found = [errors(n, 64, "none")[0] for n in (16, 32, 64)]
    rates = orders(found)
    print(f"errors {found}, orders {rates.round(2).tolist()}")
    assert rates.min() > 2.6
    assert all(error < ceiling for error, ceiling in zip(found[-1], (2.0e-5, 4.2e-5, 7.0e-5)))


@pytest.mark.parametrize(("scaling", "decades"), [("none", 12), ("kinetic", 2)])
def test_random_cells_stay_positive(scaling, decades):
    """Densities over twelve decades, with scaling two; temperatures over a factor of two; the largest step allowed.

    With more contrast and scaling it is the correction of g to its moments that ends the run, not its sign.
    """
    rng = np.random.default_rng(7)
    density, temperature = 10.0 ** rng.uniform(-decades, 0, (8, 9)), rng.uniform(1.0, 2.0, (8, 9))
    job = build(
        space={"cells": [9, 8], "lower": [0.0, 0.0], "upper": [1.0, 1.0], "boundary": dict.fromkeys("xy", "periodic")},
        velocity={"points": [12, 14], "half_width": 9.0},
        scaling=scaling,
        scheme={"conservative": scaling == "kinetic"},
        collision={"operator": "none"},
        initial={"state": "uniform"},
        time={"end": 1.0, "max_steps": 12},
    )
    simulation = Simulation(job, lambda x, y: (density, np.zeros((8, 9, 2)), temperature))
    for _ in simulation:
        assert simulation.diagnostics.row["min_g"] >= 0.0
    assert simulation.number == 12
    mass = simulation.moments()["density"].mean()
    assert abs(mass / density.mean() - 1.0) < 1e-13
