"""What `rvm check` says in words of a job that can start but may not show what is wanted: each with number and cure."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, floor, isfinite, log10, sqrt
from typing import TYPE_CHECKING

import numpy as np

from rvm_mpi.advice import initial, physics, stability
from rvm_mpi.step import fit

if TYPE_CHECKING:
    from rvm_mpi.advice.initial import StartFields
    from rvm_mpi.job.job import Job

#: numbers above it are not worth a word
LARGEST = 1e100
#: e-foldings below which noise that is to become clusters has hardly grown
FOLDS = 3.0


def verdicts(job: Job) -> Iterator[str]:
    """One line each."""
    start = initial.start_fields(job)
    yield from _cells(job)
    yield from _speeds(job, start)
    yield from _clustering(job, start)


def _cells(job: Job) -> Iterator[str]:
    """Cells wider than a mean free path."""
    gas = physics.physics(job)
    if gas is None or job.space.dimensions == 0 or gas.coarse < physics.COARSE:
        return
    assert job.collision.knudsen is not None
    wide = max(job.space.spacing) / max(gas.shortest, 1e-300)
    if not wide * job.collision.knudsen < LARGEST:
        return
    cells = [
        max(n, ceil(length / max(gas.shortest, 1e-300)))
        for n, length in zip(job.space.cells, job.space.length, strict=True)
    ]
    knudsen = _rounded_up(job.collision.knudsen * wide)
    finer = f"space.cells = {cells} or " if max(cells) <= 65536 else ""
    yield (
        f"cells are {1 / gas.cells_per_mean_free_path:.3g} mean free paths wide in the mean state, and wider than one "
        f"in {100 * gas.coarse:.0f} % of the gas: there smooth flow is that of the fluid limit, while layers at walls, "
        f"shocks and free flight are not resolved; for those take {finer}collision.knudsen = {knudsen:g}, or more"
    )


def _rounded_up(value: float) -> float:
    """To two digits."""
    if not 0.0 < value < LARGEST:
        return value
    unit = 10.0 ** (floor(log10(value)) - 1)
    return float(f"{ceil(value / unit * (1 - 1e-12)) * unit:.6g}")


def _speeds(job: Job, start: StartFields) -> Iterator[str]:
    """States and walls faster than the rescaled grid carries: T_g = T/(T + |u|^2/d) is left of their temperature."""
    if job.scaling.kind in ("none", "thermal"):
        return
    d = job.velocity.dimensions
    least = max(map(fit.holds_anywhere, job.velocity.spacing))
    fastest = np.unravel_index(int(np.argmin(start.temperature / start.omega**2)), start.omega.shape)
    gases = [("the initial state", float(start.temperature[fastest]), start.velocity[fastest])]
    for name, side in job.space.sides.items():
        if side.temperature is not None and side.velocity is not None:
            what = f"the wall at {name}" if side.kind == "maxwell" else f"the gas from {name}"
            gases.append((what, side.temperature, np.array(side.velocity)))
    for what, temperature, velocity in gases:
        speed2 = float(np.sum(velocity**2))
        if speed2 == 0.0:
            continue
        left = temperature / (temperature + speed2 / d)
        if left >= least:
            continue
        enough = fit.points_for(job, left)
        cure = f"take velocity.points = {enough}" if enough else "take more points along each direction"
        yield (
            f"{what} moves at Mach {sqrt(speed2 / temperature * d / (d + 2)):.3g} (speed {sqrt(speed2):.3g}), faster "
            f"than the velocity grid carries (Mach {mach_carried(job):.3g}): its T_g is {left:.3g}, along some "
            f"direction the grid needs {least:.3g}; heat and stress are wrong there, and the run may end; {cure}"
        )


def mach_carried(job: Job) -> float:
    """The Mach number up to which every direction holds the Gaussian of a gas in any direction's flow; 0 for none."""
    d, least = job.velocity.dimensions, max(map(fit.holds_anywhere, job.velocity.spacing))
    return sqrt(d * (1 / least - 1) * d / (d + 2)) if least < 1 else 0.0


def clustering_words(job: Job) -> str:
    """How a cooling gas in a periodic box stands to its critical wavelengths; empty for other jobs."""
    found = stability.clustering(job, *initial.mean_state(initial.start_fields(job)))
    if found is None:
        return ""
    shear = "" if found.shear == 0.0 else f"{found.shear:.3g} critical wavelengths of shear and "
    folds = f"{found.folds:.3g} e-foldings until t = {job.time.end:g}" if not found.stable else "no wave grows"
    return f"the box is {shear}{found.heat:.3g} of the heat mode long: {folds}"


def _clustering(job: Job, start: StartFields) -> Iterator[str]:
    """Noise in a periodic box of cooling gas that cannot become clusters, or has no time to."""
    found = stability.clustering(job, *initial.mean_state(start))
    if found is None or job.initial.state != "random-density":
        return
    knudsen, most = job.collision.knudsen, max(found.shear, found.heat)
    assert knudsen is not None
    if found.stable:
        long, thin = _rounded_up(3 * max(job.space.length) / most), knudsen * most / 3
        yield (
            f"the box is stable against clustering: {most:.3g} critical wavelengths long, so the noise decays and no "
            f"cluster forms; take a side of {long:g} or collision.knudsen = {thin:.2g}, for three"
        )
    elif found.folds < FOLDS:
        later = f"take time.end = {_rounded_up(found.wanted):g}, for {FOLDS:g}, or a longer box"
        if not isfinite(found.wanted):
            later = f"they do not come to {FOLDS:g} at any time; take a longer box"
        yield (
            f"clusters have hardly begun at the end: {found.folds:.3g} e-foldings of the fastest wave until t = "
            f"{job.time.end:g}; {later}"
        )
