"""The fourth cumulant a_2 of the homogeneous cooling state on a velocity grid, beside the exact one.

a_2 = <|xi|^4> d/((d + 2) <|xi|^2>^2) - 1 of g. With the Boltzmann operator from a measured table
(`accuracy_tables.py`); the granular ES-BGK model cools as a Gaussian, whose samples on the nodes have an a_2 of their
own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.advice.accuracy_tables import COOLING, COOLING_HALF_WIDTHS, COOLING_RESTITUTIONS, EXACT_A2
from rvm_mpi.advice.conduction import fourth_moment

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job


def exact_a2(dimensions: int, restitution: float) -> float:
    """That of hard spheres by Sonine theory, between the restitution coefficients for which it was worked out."""
    coefficients, cumulants = zip(*EXACT_A2[dimensions], strict=True)
    return float(np.interp(restitution, coefficients, cumulants))


def a2_error(drift: str, points: Iterable[int], half_width: float, restitution: float) -> float:
    """What operator and drift add to `exact_a2`, moments held; not a number where no run says so.

    Of the measured numbers of points the nearest that is not finer counts, of restitution coefficients outside the
    measured ones the nearest.

    Parameters
    ----------
    drift : str
        A key of `accuracy_tables.COOLING`.
    points : iterable of int
        In each direction of velocity, two or three.
    half_width, restitution : float
        V and e.
    """
    points = tuple(points)
    d = len(points)
    widths, table = COOLING_HALF_WIDTHS[d], COOLING[d][drift]
    # beyond the widest box the spacing alone counts: as many points as have it there
    wanted = min(points) * min(1.0, widths[-1] / half_width)
    measured = [n for n in table if n <= wanted + 1e-9]
    if not measured or half_width < widths[0]:
        return float("nan")
    by_restitution = [np.interp(half_width, widths, row) for row in table[max(measured)]]
    inelastic = [1.0 - e**2 for e in COOLING_RESTITUTIONS[d]]
    return float(np.interp(1.0 - restitution**2, inelastic[::-1], by_restitution[::-1]))


def gaussian_a2(points: Iterable[int], half_width: Iterable[float]) -> float:
    """a_2 of the discrete Gaussian at rest of unit temperature; infinite where the grid holds none."""
    excess = [fourth_moment(n, width, 1.0) - 3.0 for n, width in zip(points, half_width, strict=True)]
    return sum(excess) / (len(excess) * (len(excess) + 2))


def describe(job: Job) -> Iterator[tuple[str, str]]:
    """Names and texts of the lines of `rvm check`, for gases that cool in rescaled velocities.

    There is no line where nothing was measured: other drifts or kernels, and one dimension of velocity with the
    Boltzmann operator, where the state is no near Maxwellian and no theory is at hand.
    """
    collision, velocity, d = job.collision, job.velocity, job.velocity.dimensions
    e = collision.restitution
    if job.scaling.kind == "none" or e is None or e == 1.0:
        return
    if collision.facts.relaxes:
        a2 = gaussian_a2(velocity.points, velocity.half_width)
        if np.isfinite(a2):
            yield "cooling state", f"fourth cumulant {_signed(a2)} on this velocity grid, exactly 0 in this model"
    elif collision.explicit and collision.exponent == 1.0 and job.scheme.drift in COOLING.get(d, {}):
        exact = exact_a2(d, e)
        found = exact + a2_error(job.scheme.drift, velocity.points, velocity.half_width[0], e)
        text = f"{_signed(found)} on this velocity grid" if np.isfinite(found) else "off by more than was ever measured"
        if not job.scheme.conservative:
            text += " if its moments were held"
        yield "cooling state", f"fourth cumulant {text}, exactly {_signed(exact)}"


def _signed(a2: float) -> str:
    """A cumulant to four digits behind the point, zero without a sign."""
    return f"{round(a2, 4) + 0.0:.4f}"
