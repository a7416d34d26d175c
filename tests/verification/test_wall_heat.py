"""Heat that walls receive and the work that the gas does on them: in the wall's own frame, with the right sign."""

from math import pi, sqrt

import numpy as np
import pytest

from rvm_mpi import Simulation
from rvm_mpi.results import open_run
from rvm_mpi.run.run import run_job
from tests.verification.kinetic_cases import build, es_bgk


def moving(speed, temperature=1.0, accommodation=1.0, along=1, d=2):
    velocity = [0.0] * d
    velocity[along] = speed
    return {"kind": "maxwell", "accommodation": accommodation, "temperature": temperature, "velocity": velocity}


def couette(speed=0.5, end=12.0, scaling="kinetic", cells=12):
    return build(
        space={"cells": [cells], "boundary": {"x": {"lower": moving(-speed), "upper": moving(speed)}}},
        velocity={"points": [24, 16], "half_width": [6.0, 6.0]},
        scaling=scaling,
        collision={"operator": "none"},
        initial={"state": "uniform"},
        time={"end": end},
    )


def free_molecular_shear(speed, flux):
    """Molecules leave with the mean velocity of the wall they come from: the flux of mass times the difference."""
    return flux * 2 * speed


@pytest.mark.parametrize("scaling", ["none", "kinetic"])
def test_free_molecular_couette_heats_both_walls(scaling):
    """Shear 2 speed rho sqrt(T/(2 pi)) on each wall; the heat it gets is what its motion puts in, shear x speed."""
    speed = 0.5
    simulation = Simulation(couette(speed, scaling=scaling))
    for _ in simulation:
        pass
    walls = simulation.walls()
    gas = {name: float(values.mean()) for name, values in simulation.moments().items()}
    # the gas keeps its mass: its density, and with it the flux, is that of the start
    shear = free_molecular_shear(speed, sqrt(1 / (2 * pi)))
    for side, sign in (("x-lower", -1.0), ("x-upper", 1.0)):
        heat, work = walls[f"wall/{side}/heat_flux"], walls[f"wall/{side}/work"]
        # the gas holds each wall back
        assert walls[f"wall/{side}/shear_stress"][0, 1] == pytest.approx(-sign * shear, rel=0.02)
        assert heat == pytest.approx(0.1995, rel=0.02)
        assert work == pytest.approx(-0.1995, rel=0.02)
        assert abs(heat + work) < 5e-3, "steady: nothing is left in the gas"
    assert gas["density"] == pytest.approx(1.0, rel=1e-12)
    # pressure tensor: the integral of c c^T f
    moments = simulation.moments()
    assert np.array_equal(moments["pressure_tensor"], moments["density"][..., None, None] * moments["stress"])
    trace = np.trace(moments["pressure_tensor"], axis1=-2, axis2=-1) / 2
    np.testing.assert_allclose(trace, moments["density"] * moments["temperature"], rtol=1e-14)


def test_heat_and_work_are_the_energy_that_leaves_the_gas():
    """Step by step, walls of unlike temperature, speed and accommodation on all four sides, a cooling gas."""
    job = build(
        space={
            "cells": [5, 4],
            "boundary": {
                "x": {"lower": moving(0.4, 1.3, 0.7), "upper": moving(-0.3, 0.8)},
                "y": {"lower": moving(0.6, 1.1, along=0), "upper": "specular"},
            },
        },
        velocity={"points": [12, 12], "half_width": 6.0},
        collision=es_bgk(0.3),
        initial={"state": "wave", "mode": [0.5, 1], "temperature_amplitude": 0.3, "density_amplitude": 0.2},
        time={"end": 1.0, "max_steps": 12},
    )
    simulation = Simulation(job)
    width = {"x": simulation.domain.spacing[1], "y": simulation.domain.spacing[0]}  # of a face
    energy = simulation.diagnostics.row["energy"]
    drives = 0.0
    for step in simulation:
        walls, left = simulation.walls(), 0.0
        for side in job.space.sides:
            heat, work, shear = (walls[f"wall/{side}/{name}"] for name in ("heat_flux", "work", "shear_stress"))
            velocity = job.space.sides[side].velocity or (0.0, 0.0)
            np.testing.assert_allclose(work, shear @ np.array(velocity), rtol=1e-14, atol=1e-300)
            left += step.dt * width[side[0]] * float((heat + work).sum())
            drives += abs(float(work.sum()))
        after = simulation.diagnostics.row["energy"]
        assert energy - after == pytest.approx(left, abs=2e-15 * energy)
        energy = after
    assert drives > 0.1


def test_the_file_has_work_beside_heat_and_says_what_they_are(tmp_path):
    assert run_job(couette(end=0.1), tmp_path / "run", quiet=True) == 0
    run = open_run(tmp_path / "run")
    for name, words in {"heat_flux": "in the wall's own frame", "work": "positive where the gas drives"}.items():
        found = run[f"wall_x_lower_{name}"]
        assert words in found.attrs["long_name"] and found.attrs["units"] == "reference pressure x speed"
        assert np.isfinite(found.values).all()
    assert run["kinetic_pressure_tensor"].dims == ("time", "x", "component", "other_component")
