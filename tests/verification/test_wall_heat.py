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


@pytest.mark.parametrize("scaling", ["none", "kinetic", "thermal"])
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


def between_walls(d, axis, temperatures, speed, accommodations, unit):
    """A gas without collisions between two walls that slide along each other, until it is steady."""
    along = 1 - axis
    cells = [8] if axis == 0 else [3, 8]
    lower, upper = (
        moving(sign * speed * unit, temperature * unit**2, accommodation, along, d)
        for sign, temperature, accommodation in zip((-1, 1), temperatures, accommodations)
    )
    boundary = {"xy"[axis]: {"lower": lower, "upper": upper}} | ({"x": "periodic"} if axis else {})
    points = [12] * d
    points[axis] = 40  # half of them, those that leave a wall, carry h^2/24 too much
    mean = sqrt(temperatures[0] * temperatures[1])
    return build(
        space={"cells": cells, "boundary": boundary},
        velocity={"points": points, "half_width": 6.0},
        collision={"operator": "none"},
        initial={"state": "uniform", "temperature": mean * unit**2},
        time={"end": 12.0 / unit},
    )


CASES = [
    (2, 0, (1.0, 1.6), 0.4, (1.0, 1.0), 1.0),
    (2, 0, (1.5, 1.0), 0.3, (0.6, 0.9), 1.0),
    (2, 1, (1.0, 1.4), 0.4, (1.0, 0.7), 0.01),
    (3, 0, (1.3, 1.0), 0.5, (0.8, 1.0), 30.0),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_walls_that_heat_and_shear_without_collisions(case):
    """Both streams carry the flux of mass; of what a wall gives, share a1 a2/(a1 + a2 - a1 a2) reaches the other.

    A wall of temperature T and velocity u gives (d + 1)/2 T + u^2/2 of energy with each mass.
    """
    d, axis, (cold, hot), speed, (first, second), unit = case
    simulation = Simulation(between_walls(*case))
    for _ in simulation:
        pass
    whole = first + second - first * second
    # mass of each half: of what left the one wall, and the other
    shares = (first * (2 - second), second * (2 - first))
    flux = sqrt(2 / pi) / (sum(share / sqrt(t) for share, t in zip(shares, (cold, hot))) / whole)
    exchanged = flux * first * second / whole
    walls, names = simulation.walls(), [f"wall/{'xy'[axis]}-{end}" for end in ("lower", "upper")]
    for name, sign in zip(names, (1, -1)):
        shear = walls[f"{name}/shear_stress"][0, 1 - axis] / unit**2
        assert shear == pytest.approx(sign * exchanged * 2 * speed, rel=0.02)
        energy = (walls[f"{name}/heat_flux"][0] + walls[f"{name}/work"][0]) / unit**3
        assert energy == pytest.approx(sign * exchanged * (d + 1) / 2 * (hot - cold), rel=0.03, abs=0.005)
        # the work is done against the shear, by the wall's own velocity
        assert walls[f"{name}/work"][0] / unit**3 == pytest.approx(-speed * abs(shear), rel=1e-12)


def test_the_file_has_work_beside_heat_and_says_what_they_are(tmp_path):
    assert run_job(couette(end=0.1), tmp_path / "run", quiet=True) == 0
    run = open_run(tmp_path / "run")
    for name, words in {"heat_flux": "in the wall's own frame", "work": "positive where the gas drives"}.items():
        found = run[f"wall_x_lower_{name}"]
        assert words in found.attrs["long_name"] and found.attrs["units"] == "reference pressure x speed"
        assert np.isfinite(found.values).all()
    assert run["kinetic_pressure_tensor"].dims == ("time", "x", "component", "other_component")
