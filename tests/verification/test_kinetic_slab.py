"""A slab of Test 5 against a run in classical variables; `benchmarks/slab.py` has the full table."""

from itertools import product

import pytest

from tests.verification.slab import errors, reference, slab


@pytest.fixture(scope="module")
def exact():
    return reference(128, 400)


def test_errors_of_the_scalings_against_classical_variables(exact):
    """Relative L1 errors of density, velocity and temperature at t = 0.1 with 24 velocities on 32 cells."""
    found = {}
    for name, scaling, synchronise in (
        ("kinetic", "kinetic", 0.0),
        ("macroscopic", "macroscopic", 0.0),
        ("synchronised", "macroscopic", 200.0),
        ("automatic", "macroscopic", "auto"),
    ):
        *numerical, simulation = slab(32, 24, 7.0, scaling, synchronise, conservative=scaling == "kinetic")
        found[name] = errors(numerical, exact)
        row = simulation.diagnostics.row
        print(f"{name}: errors {found[name]}, {simulation.number} steps, energy error {row['energy_error']:.1e}")
        assert row["min_g"] >= 0 and abs(row["mass_error"]) < 1e-13
    assert found["kinetic"][0] < 0.035 and found["kinetic"][2] < 0.045
    for name in ("synchronised", "automatic"):
        assert found[name][0] < 0.04 and found[name][2] < 0.06
    assert found["kinetic"][0] < found["macroscopic"][0] < 0.1
    assert found["kinetic"][2] < found["macroscopic"][2] < 0.15


def test_positive_seventh_order_drift_needs_fewer_velocities(exact):
    """With 16 velocities about what Van Leer's limiter gives with 24, where omega jumps by ten."""
    found = {}
    for points, drift in product((16, 24), ("seventh-order-positive", "van-leer")):
        *numerical, simulation = slab(32, points, 7.0, "kinetic", drift=drift)
        found[points, drift] = errors(numerical, exact)
        row = simulation.diagnostics.row
        print(f"{points} velocities, {drift}: errors {found[points, drift]}")
        assert row["min_g"] >= 0 and abs(row["mass_error"]) < 1e-13
    for points in (16, 24):
        assert all(a < b for a, b in zip(found[points, "seventh-order-positive"], found[points, "van-leer"]))
    positive = found[16, "seventh-order-positive"]
    # the error of 16 velocities, which that of the cells no longer hides: the same on 64 cells
    assert all(a < 0.75 * b for a, b in zip(positive, found[16, "van-leer"]))
    assert all(a < b for a, b in zip(positive, (0.022, 0.1, 0.03)))
    assert positive[1] < 1.1 * found[24, "van-leer"][1]
