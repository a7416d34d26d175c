"""What the tables say of the Boltzmann operator on coarse grids is what a gas with a gradient of temperature does."""

import numpy as np
import pytest

from rvm_mpi import Simulation
from rvm_mpi.advice.accuracy import operator_worth
from tests.verification.kinetic_cases import build, line

KNUDSEN = 0.05
#: ten of the heat flux's relaxation times, hard discs: 15/16 pi^(3/2) b
END = 10 * KNUDSEN / (15 / 16 * np.pi**1.5)


def heat_flux(points, half_width):
    """Amplitude of the heat flux of a wave of temperature when it has lasted for ten relaxation times."""
    simulation = Simulation(
        build(
            space=line(24),
            velocity={"points": [points] * 2, "half_width": half_width},
            scaling="none",
            collision={"operator": "boltzmann", "knudsen": KNUDSEN, "restitution": 1.0},
            initial={"state": "wave", "temperature_amplitude": 0.01, "density_amplitude": -0.01},
            time={"end": END},
        )
    )
    for _ in simulation:
        pass
    x = (np.arange(24) + 0.5) / 24
    return float(simulation.moments()["heat_flux"][0, :, 0] @ np.sin(2 * np.pi * x))


@pytest.mark.parametrize(("points", "half_width"), [(16, 6.0), (17, 7.0), (20, 7.0)])
def test_heat_flux_on_coarse_grids(points, half_width):
    found = heat_flux(points, half_width) / heat_flux(32, 8.0)
    worth = operator_worth((points, points), half_width, 1.0).conductivity
    print(f"{points} x {points}, half width {half_width}: {found:.3f}, table {worth:.3f}")
    assert abs(worth - 1) > 0.05 and found - 1 == pytest.approx(worth - 1, rel=0.35)
