"""Powers of two that take a job's units out of a run, so that its bits do not depend on them.

Numbers scale exactly with powers of two, but exponentials, logarithms, roots of odd powers and the range of doubles do
not. So g, which has all of these, is kept in units of the gas itself: the powers of two nearest to the largest density
and, where velocities are not rescaled, to the thermal speed at the start. What a user reads is in the job's units.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np


class GasUnits(NamedTuple):
    """The units that g is kept in.

    Attributes
    ----------
    density, velocity : float
        Powers of two; one unit of velocity is one of xi, so it is 1 where velocities are rescaled by the gas itself.
    g : float
        What a value of g must be multiplied by to be in the job's units.
    """

    density: float
    velocity: float
    g: float

    @classmethod
    def of(cls, density: float, temperature: float, rescaled: bool, dimensions: int) -> GasUnits:
        """Those of a gas whose largest density and temperature are given, in so many velocity dimensions."""
        unit = nearest_power_of_two(density)
        velocity = 1.0 if rescaled else nearest_power_of_two(math.sqrt(temperature))
        return cls(unit, velocity, unit / velocity**dimensions)


def nearest_power_of_two(value: float) -> float:
    """The power of two nearest to a positive number, in the logarithm; 2 value has twice that of value, exactly."""
    mantissa, exponent = math.frexp(value)  # 1/2 <= mantissa < 1
    return math.ldexp(1.0, exponent if mantissa * mantissa >= 0.5 else exponent - 1)


def power(x, exponent):  # type: ignore[no-untyped-def]
    """x^exponent of a positive number or array; with a multiple of 1/2 by products and a root.

    These scale exactly with x by powers of two (of four, where there is a root); a library's power does not promise to.
    Plain Python and a kernel's part alike (`step/relaxation.py`).
    """
    halves = math.floor(abs(2.0 * exponent))
    if halves != abs(2.0 * exponent) or halves > 16:
        return x**exponent
    result = np.sqrt(x) if halves % 2 == 1 else x / x
    for _ in range(halves // 2):
        result = result * x
    return 1.0 / result if exponent < 0.0 else result
