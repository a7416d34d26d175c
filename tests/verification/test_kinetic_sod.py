"""Sod's shock tube at small Knudsen number against the exact Euler solution."""

import numpy as np
import pytest

from tests.verification.kinetic_cases import orders
from tests.verification.sod import errors, tube

GRIDS = {1: [24], 2: [24, 12], 3: [16, 10, 10]}
WIDTHS = {1: 7.0, 2: [7.0, 6.0], 3: [7.0, 6.0, 6.0]}
CEILINGS = {1: (0.010, 0.020, 0.014), 2: (0.008, 0.015, 0.008), 3: (0.010, 0.018, 0.009)}


@pytest.mark.parametrize("d", [1, 2, 3])
def test_fluid_limit(d):
    """Transport alone sets dt, several relaxation times long; the errors fall with the cells as the fluid's do."""
    found = []
    for cells in (40, 80) if d == 3 else (50, 100):
        simulation, depth, limits = tube(cells, GRIDS[d], 1e-5, half_width=WIDTHS[d])
        assert limits <= {"transport and drift (cfl)", "end"}
        assert depth > 3.0
        assert simulation.diagnostics.row["min_g"] >= 0
        found.append(errors(simulation))
    rates = orders(found)[0]
    print(f"d = {d}: L1 errors {found}, rates {rates.round(2)}, dt tau/eps {depth:.1f} in the dense gas")
    assert np.all(np.array(found[-1]) < CEILINGS[d])
    assert rates.min() > 0.6


def test_two_dimensions_uniform_in_y_are_the_one_dimensional_tube():
    options = {"points": [16, 8, 8], "knudsen": 1e-5, "end": 0.05, "half_width": [7.0, 5.0, 5.0]}
    flat, *_ = tube(40, **options)
    wide, *_ = tube(40, rows=3, **options)
    a, b = flat.moments(), wide.moments()
    spread = max(np.ptp(b[name], axis=0).max() for name in b)
    print(f"spread over y {spread:.1e}")
    assert spread < 1e-13
    # the step is shorter in 2D, so the two agree to the time step's error only
    difference = max(abs(a[name][0] - b[name][0]).mean() for name in ("density", "temperature"))
    print(f"1D against 2D: {difference:.1e}; against Euler {errors(flat)}, {errors(wide)}")
    assert difference < 3e-3
    assert abs(np.array(errors(flat)) - errors(wide)).max() < 3e-3


def test_error_falls_to_the_fluid_scheme_s_own_with_the_knudsen_number():
    found = [errors(tube(60, [24], knudsen)[0])[0] for knudsen in (1e-2, 1e-3, 1e-4, 1e-5, 1e-7)]
    print(f"density errors at eps = 1e-2, 1e-3, 1e-4, 1e-5, 1e-7: {found}")
    assert found[0] > 2 * found[1] > 2.5 * found[2]
    assert max(found[2:]) < 1.15 * min(found[2:])
