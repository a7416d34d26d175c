"""A slab of Test 5 against a run in classical variables; `benchmarks/slab.py` has the full table."""

from tests.verification.slab import errors, reference, slab


def test_errors_of_the_scalings_against_classical_variables():
    """Relative L1 errors of density, velocity and temperature at t = 0.1 with 24 velocities on 32 cells."""
    exact = reference(128, 400)
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
