"""Free transport against its exact solution, in classical and in rescaled velocities."""

import pytest

from tests.verification.free_transport import errors
from tests.verification.kinetic_cases import orders

CASES = {
    # scaling, conservative, drift: ceilings of the L1 errors of density, velocity, temperature on the finest grid
    ("none", False, "van-leer"): (4.0e-5, 5.0e-5, 9e-5),
    ("none", True, "van-leer"): (4.0e-5, 5.0e-5, 9e-5),
    ("macroscopic", False, "van-leer"): (2.4e-4, 5.5e-4, 4.0e-3),
    ("macroscopic", True, "van-leer"): (1.8e-4, 7.0e-4, 3.0e-3),
    ("kinetic", True, "van-leer"): (1.7e-4, 7.0e-4, 3.0e-3),
}


@pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c[0]}-{c[2]}{'-conservative' if c[1] else ''}")
def test_second_order_in_space_velocity_and_time_together(case):
    found = [errors(n, n // 2, *case)[0] for n in (32, 64, 128)]
    rates = orders(found)
    print(f"{case}: errors {found}, orders {rates.round(2).tolist()}")
    assert rates[-1].min() > 1.7
    assert all(error < ceiling for error, ceiling in zip(found[-1], CASES[case]))
