"""A drift too fast for the step, taken in substeps of its own: order in time, positivity, what it saves."""

from pathlib import Path

import numpy as np
import pytest

from rvm_mpi import Job, Simulation
from rvm_mpi.step import stepper as stepping
from tests.verification import time_order
from tests.verification.kinetic_cases import build, es_bgk, line, orders

JOBS = Path(__file__).resolve().parents[2] / "jobs"


@pytest.fixture
def always_substeps(monkeypatch):
    """Every drift counts as too fast."""
    model = stepping.physics
    monkeypatch.setattr(stepping, "physics", lambda job: model(job)._replace(courant=0.01))


@pytest.mark.parametrize("eps", [1.0, 1e-6])
def test_second_order_in_time(always_substeps, eps):
    """As with the drift beside transport (test_kinetic_time_order.py); the heat flux is O(eps) and left out at 1e-6."""
    found = time_order.errors(
        lambda dt: eps, (40, 80, 160), 640, points=[24], scaling="kinetic", drift="seventh-order"
    )
    rates = orders(found)
    print(f"eps = {eps}: errors {np.array(found).tolist()}, orders {rates.round(2).tolist()}")
    assert rates[:, : 3 if eps == 1.0 else 2].min() > 1.9
    assert max(found[0]) < 1e-5


def front(cfl: float):
    """Gas of temperature 1 beside gas of temperature 100: omega jumps by ten between two cells."""
    return build(
        space=line(48),
        velocity={"points": [16, 8], "half_width": 7.0},
        collision=es_bgk(0.05),
        initial={"state": "temperature-disc", "centre": [0.5], "radius": 0.2, "inner": 1.0, "outer": 100.0},
        time={"end": 0.005, "cfl": cfl},
    )


def run_front(cfl: float):
    """(simulation at the end, mean over the steps of dt over that for transport and drift together)."""
    simulation, gains, smallest = Simulation(front(cfl)), [], np.inf
    for step in simulation:
        local = simulation.kinetic.report
        gains.append(step.dt * (local["transport"] + local["drift"]).max() / cfl)
        smallest = min(smallest, simulation.diagnostics.row["min_g"])
    assert smallest >= 0.0
    row = simulation.diagnostics.row
    assert abs(row["mass_error"]) < 1e-14
    assert abs(row["energy_error"]) < 1e-13
    return simulation, np.mean(gains)


def test_a_steep_front_takes_long_steps():
    """Several times longer than transport and drift together allow, for an error of some 1e-3, falling with cfl."""
    names = ("density", "temperature")
    exact = run_front(0.02)[0].moments()
    errors = []
    for cfl in (0.5, 0.25):
        simulation, gain = run_front(cfl)
        assert gain > 3.0
        moments = simulation.moments()
        errors.append([np.abs(moments[name] - exact[name]).mean() / exact[name].mean() for name in names])
        print(f"cfl {cfl}: {simulation.number} steps, {gain:.3g} times as long, errors {errors[-1]}")
    assert max(errors[0]) < 1e-2
    assert np.all(np.array(errors[1]) < 0.9 * np.array(errors[0]))


def test_a_cooling_gas_is_not_split():
    """The drift that balances the Boltzmann operator in the cooling state goes with it, not in substeps of its own.

    Split, the balance is missed by O(dt^2) to the same side in each step, and where omega follows from g itself the
    error of T_g grows like omega^-2: it was 0.02 here.
    """
    changes = ['scheme.drift="seventh-order"', "velocity.points=[48, 48]", "time.end=10", "output.times=[10]"]
    simulation = Simulation(Job.from_file(JOBS / "test1_coupled.toml", changes))
    for _ in simulation:
        pass
    scaled = simulation.kinetic.fields()["temperature"] / simulation.kinetic.omega**2
    print(f"T_g = {scaled.item():.6f} after {simulation.number} steps")
    assert abs(scaled.item() - 1.0) < 1e-3
