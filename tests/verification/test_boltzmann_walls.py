"""Walls where the spectral operator has left g negative in places: no mass goes through, whatever the sign of g."""

import numpy as np
import pytest

from rvm_mpi import Job, Simulation

WALLS = {
    "specular": "specular",
    "diffuse": {"kind": "diffuse", "temperature": 1.4},
    "maxwell": {"kind": "maxwell", "accommodation": 0.4, "temperature": 0.7},
}
SLIDING = {"velocity": [0.0, 0.3]}


def between_walls(kind, points, scaling="kinetic", conservative=True, end=0.1, cells=12):
    """A granular gas between two walls of one kind, set in motion by a wave of its density."""
    wall = WALLS[kind]
    if kind == "maxwell" and len(points) == 2:
        wall = {**wall, **SLIDING}
    return Job.from_dict(
        {
            "space": {"cells": [cells], "boundary": {"x": wall}},
            "velocity": {"points": points, "half_width": 9.0},
            "scaling": {"kind": scaling},
            "scheme": {"conservative": conservative},
            "fluid": {"enabled": scaling == "macroscopic"},
            "collision": {"operator": "boltzmann", "knudsen": 0.2, "restitution": 0.8},
            "initial": {"state": "wave", "density_amplitude": 0.2, "mode": [0.5]},
            "time": {"end": end},
        }
    )


@pytest.mark.parametrize("points", [[40], [20, 16]])
@pytest.mark.parametrize("kind", list(WALLS))
def test_no_mass_goes_through_where_g_is_negative(kind, points):
    """A quarter of g's values in the two cells before each wall, large ones included, has its sign turned."""
    simulation = Simulation(between_walls(kind, points))
    kinetic = simulation.kinetic
    weight = kinetic.velocity_grid.weight
    g = kinetic.velocity_grid.unpack(kinetic.state()[0][0])
    assert np.shares_memory(g, kinetic.g)
    turned = np.indices(g.shape[1:]).sum(axis=0) % 4 == 1
    for cell in (0, 1, -2, -1):
        g[cell][turned] *= -0.5
    kinetic.refresh_sums()
    sums, carried, omega = kinetic.now.sums, kinetic.now.carried, kinetic.omega
    carried[..., 0] = weight * sums[..., 0]
    carried[..., 1:4] = weight * omega[..., None] * sums[..., 1:4]
    carried[..., 4] = 0.5 * weight * omega**2 * (sums[..., 4] + sums[..., 7] + sums[..., 9])
    mass = carried[..., 0].sum()

    speed = kinetic.velocity_grid.x[:, None, None]
    scale = {name: omega[0, c] * weight * np.abs(speed * g[c]).sum() for name, c in (("x-lower", 0), ("x-upper", -1))}
    for cell, hits in ((0, speed < 0), (-1, speed > 0)):
        assert (g[cell] * hits).min() < -0.05 * g[cell].max()
    kinetic.first_stage(1e-3)
    kinetic.measure_sides()
    for side, through in kinetic.through.items():
        assert abs(through[0, 0]) < 1e-15 * scale[side]
        if kind != "specular":
            assert abs(through[0, 4]) > 1e-2 * scale[side], "energy does go through"
    kinetic.later_stages(1e-3)
    assert kinetic.now.carried[..., 0].sum() == pytest.approx(mass, rel=1e-15)
    assert weight * kinetic.now.sums[..., 0].sum() == pytest.approx(mass, rel=1e-14)


@pytest.mark.parametrize("points", [[20], [16, 16]])
@pytest.mark.parametrize("kind", list(WALLS))
@pytest.mark.parametrize(("scaling", "conservative"), [("kinetic", True), ("macroscopic", False), ("none", False)])
def test_mass_of_whole_runs(kind, points, scaling, conservative):
    """On too few velocities the operator itself makes g negative, next to the walls too."""
    simulation = Simulation(between_walls(kind, points, scaling, conservative))
    least, worst = 0.0, 0.0
    for _ in simulation:
        row = simulation.diagnostics.row
        worst = max(worst, abs(row["mass_error"]))
        g = simulation.kinetic.state()[0][0]
        least = min(least, g[0].min() / g[0].max(), g[-1].min() / g[-1].max())
    entered = max(abs(value) for name, value in row.items() if name.startswith("entered_mass"))
    print(f"{kind}, {scaling}, {points}: least g {least:.1e}, mass {worst:.1e}, entered {entered:.1e}")
    assert least < -1e-6
    assert worst < 1e-14
    assert entered < 1e-15
