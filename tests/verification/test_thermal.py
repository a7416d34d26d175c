"""The thermal scaling, v = u + sqrt(T) xi: flows at any Mach number against exact and fine answers."""

import numpy as np
import pytest

from rvm_mpi import Simulation
from tests.verification.euler_exact import riemann
from tests.verification.kinetic_cases import build, coarsen, es_bgk, line, run
from tests.verification.slab import errors, reference, slab

HARD_SPHERES = {"density": 1.0, "temperature": 0.5}


def tube(left, right, end, points, half_width, knudsen, cells=100):
    """A Riemann problem of (density, velocity along x, temperature) on the unit interval."""
    d = len(points)
    states = [
        {"density": density, "velocity": [speed] + [0.0] * (d - 1), "temperature": temperature}
        for density, speed, temperature in (left, right)
    ]
    return build(
        space=line(cells, "far-field"),
        velocity={"points": list(points), "half_width": half_width},
        scaling="thermal",
        collision=es_bgk(knudsen, 1.0, **HARD_SPHERES, prandtl=1.0 if d == 1 else 2 / 3),
        initial={"state": "riemann", "left": states[0], "right": states[1]},
        time={"end": end},
    )


def balanced(simulation):
    """Mass, momentum and energy to rounding, and g positive."""
    row = simulation.diagnostics.row
    assert row["min_g"] >= 0.0
    assert max(abs(row[f"{name}_error"]) for name in ("mass", "momentum", "energy")) < 1e-12


def test_slab_of_test_5_is_nearer_than_in_the_kinetic_scaling():
    """Cold between hot gas, 64 cells: every error smaller at any number of velocities, of temperature by half at 16."""
    exact = reference(128, 400)
    for points, half_width in ((12, 5.0), (16, 6.0), (24, 7.0)):
        found = {}
        for scaling in ("kinetic", "thermal"):
            *numerical, simulation = slab(64, points, half_width, scaling, drift="maxwellian")
            found[scaling] = errors(numerical, exact)
            balanced(simulation)
        print(points, half_width, {name: np.round(e, 4).tolist() for name, e in found.items()})
        assert all(a < 1.02 * b for a, b in zip(found["thermal"], found["kinetic"]))
        if points < 24:
            assert found["thermal"][2] < 0.65 * found["kinetic"][2]


@pytest.mark.parametrize("speed", [3.0, 10.0])
def test_streams_that_meet_make_the_shocks_of_the_fluid(speed):
    """At Mach 2.3 and 7.7 on twelve velocities: density and temperature between the shocks as Rankine and Hugoniot."""
    end = 0.6 / speed
    simulation = run(tube((1.0, speed, 1.0), (1.0, -speed, 1.0), end, (12, 10, 10), 5.0, 0.001))
    balanced(simulation)
    moments = simulation.moments()
    middle = slice(36, 46)  # behind the shock, beside the middle, where the first meeting leaves hot gas
    density, _, pressure = riemann((1.0, speed, 1.0), (1.0, -speed, 1.0), np.zeros(1), 5 / 3)
    found = moments["density"][0, middle].mean(), moments["temperature"][0, middle].mean()
    print(f"{found}, exact {density[0]}, {pressure[0] / density[0]}")
    assert found == pytest.approx((density[0], pressure[0] / density[0]), rel=0.02)


LIVE = {
    "near-vacuum": ((1.0, 0.0, 1.0), (1e-9, 0.0, 0.05), 0.1),
    "hot beside cold": ((1.0, 0.0, 1e6), (1.0, 0.0, 1.0), 5e-4),
    "fast jet": ((1.0, 30.0, 1.0), (1.0, 0.0, 1.0), 0.02),
    "apart": ((1.0, -3.0, 1.0), (1.0, 3.0, 1.0), 0.06),
    "cold wind": ((1.0, 3.0, 1.0), (1.0, 0.0, 0.01), 0.1),
}


@pytest.mark.parametrize("points", [(12,), (10, 10, 8)], ids=["1v", "3v"])
@pytest.mark.parametrize("case", list(LIVE))
@pytest.mark.parametrize("knudsen", [0.05, 0.001])
def test_strong_jumps_live_and_balance(case, points, knudsen):
    *states, end = LIVE[case]
    balanced(run(tube(*states, end, points, 5.0, knudsen, cells=50)))


def moving_wave(cells, speed, end=0.125):
    """A wave of density, velocity and temperature that the gas carries along, brought back to where it would be."""
    job = build(
        space=line(cells),
        velocity={"points": [12, 12], "half_width": 6.0},
        scaling="thermal",
        collision=es_bgk(0.1, 1.0, **HARD_SPHERES),
        initial={
            "state": "wave", "density_amplitude": 0.3, "temperature_amplitude": 0.15,
            "velocity": [speed, 0.0], "velocity_amplitude": [0.0, 0.3],
        },
        time={"end": end},
    )  # fmt: skip
    simulation = run(job)
    balanced(simulation)
    moments = simulation.moments()
    shift = -round(speed * end * cells)
    u, v = moments["velocity"][..., 0] - speed, moments["velocity"][..., 1]
    fields = moments["density"], u, v, moments["temperature"]
    return np.array([np.roll(field[0], shift) for field in fields])


def test_galilean_invariance_with_its_order():
    """The same wave at rest and at Mach 4: the difference is the scheme's error alone, of second order or more."""
    differences = []
    for cells in (32, 64, 128):
        rest, moving = moving_wave(cells, 0.0), moving_wave(cells, 5.0)
        differences.append(np.abs(moving - rest).mean())
    rates = np.log2(np.array(differences[:-1]) / differences[1:])
    print(f"differences {differences}, orders {rates.round(2)}")
    assert differences[-1] < 1e-3
    assert rates.min() > 1.7


def test_converges_to_classical_velocities():
    """A strong wave at Kn 0.1 on 128 cells against 48 classical velocities on the same cells."""
    found = {}
    for scaling, points, half_width in (("none", [48], 9.0), ("thermal", [32], 7.0)):
        simulation = run(
            build(
                space=line(128),
                velocity={"points": points, "half_width": half_width},
                scaling=scaling,
                collision=es_bgk(0.1, 1.0, **HARD_SPHERES, prandtl=1.0),
                initial={
                    "state": "wave", "density_amplitude": 0.3, "temperature_amplitude": 0.3,
                    "velocity": [0.5], "velocity_amplitude": [0.3],
                },
                time={"end": 0.2},
            )
        )
        found[scaling] = simulation.moments()
    for name in ("density", "velocity", "temperature", "heat_flux"):
        off = np.abs(found["thermal"][name] - found["none"][name]).max() / np.abs(found["none"][name]).max()
        print(f"{name}: {off:.2e}")
        assert off < (0.01 if name == "heat_flux" else 0.003)


def test_clusters_fall_together_faster_than_sound():
    """A granular gas in a long periodic box, one dimension: past Mach 1.3, where the kinetic scaling ends."""
    job = build(
        space=line(64, upper=10.0),
        velocity={"points": [12], "half_width": 5.0},
        scaling="thermal",
        collision={
            "operator": "granular-es-bgk", "knudsen": 0.02, "restitution": 0.9, "cross_section": 0.25,
            "relaxation": {"coefficient": 3.78, "density_power": 1.0, "temperature_power": 0.5},
        },
        initial={"state": "wave", "density_amplitude": 0.2},
        time={"end": 600.0},
    )  # fmt: skip
    simulation = Simulation(job)
    for _ in simulation:
        pass
    balanced(simulation)
    moments = simulation.moments()
    mach = (np.abs(moments["velocity"][..., 0]) / np.sqrt(moments["temperature"])).max()
    contrast = moments["density"].max() / moments["density"].min()
    print(f"{simulation.number} steps, largest |u|/sqrt(T) {mach:.2f}, density contrast {contrast:.1f}")
    assert mach > 1.5 and contrast > 10.0


def test_cells_refined_by_two_leave_a_quarter_of_the_error():
    """Cells refined by two change a strong wave by their second order."""
    fields = [moving_wave(cells, 2.0, end=0.125) for cells in (32, 64, 128)]
    finest = fields[-1]
    off = [
        np.abs(part - np.array([coarsen(row, part.shape[1]) for row in finest])).mean() for part in fields[:-1]
    ]
    print(f"differences from 128 cells {off}")
    assert off[1] < 0.35 * off[0]
