"""What a run watches after each step: its balances, and how much of g is in the outermost velocities.

A warning is said once when a quantity passes its threshold, and again each time it has grown by ten.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

AGAIN = 10.0
"""Growth after which a warning is repeated."""


def promised(job: Job) -> tuple[str, ...]:
    """Columns of the history that a run of this job keeps to round-off.

    Mass always; momentum and energy where the moments are carried and g is corrected to them.
    """
    return ("mass_error", "momentum_error", "energy_error") if job.scheme.conservative else ("mass_error",)


class Watch:
    """Compares the rows of the history with the thresholds of a job's `[watch]`.

    Parameters
    ----------
    job : Job
    """

    def __init__(self, job: Job) -> None:
        watch = job.watch
        # one is no threshold: where g is negative in places the outermost velocities can hold more than all
        warning, self._stop = (x if x < 1.0 else math.inf for x in (watch.box_warning, watch.box_stop))
        #: size above which a quantity is spoken of next
        self._next = dict.fromkeys(promised(job), watch.balance)
        self._next.update({"box_mass": warning, "box_energy": warning})

    def warnings(self, row: Mapping[str, float]) -> list[str]:
        """Lines on what has passed its threshold with this row, or grown by ten since it was spoken of."""
        lines = []
        for name, threshold in self._next.items():
            size = _size(name, row)
            if size <= threshold:
                continue
            self._next[name] = AGAIN * size
            cure = _CURE if name.startswith("box") else ""
            lines.append(f"{_WORDS[name].format(size)} in step {row['step']:.0f} at t = {row['time']:.6g}{cure}")
        return lines

    def reason_to_stop(self, row: Mapping[str, float]) -> str:
        """Why the run must not go on with this row; empty if it may."""
        for name in ("box_mass", "box_energy"):
            if _size(name, row) > self._stop:
                return f"{_WORDS[name].format(_size(name, row))}, above watch.box_stop = {self._stop:g}"
        return ""


def _size(name: str, row: Mapping[str, float]) -> float:
    """What is compared with the threshold: of a balance its error over what there was and what passed the sides.

    Sums of what entered round at their own size, which grows without end between open sides.
    """
    part = name.removesuffix("_error")
    entered = sum(abs(value) for key, value in row.items() if key.startswith(f"entered_{part}"))
    if entered == 0.0:
        return abs(row[name])
    unit = math.sqrt(row["mass"] * row["energy"]) if part == "momentum" else row[part]
    return abs(row[name]) / (1.0 + entered / unit)


_WORDS = {
    "mass_error": "the balance of mass is off by {:.2g} of what there was and what came through the sides",
    "momentum_error": "the balance of momentum is off by {:.2g} of mass times omega and what came through the sides",
    "energy_error": "the balance of energy is off by {:.2g} of what there was and what came through the sides",
    "box_mass": "the outermost velocities hold {:.2g} of some cell's mass",
    "box_energy": "the outermost velocities hold {:.2g} of some cell's energy",
}
_CURE = ": a wider velocity.half_width holds it, but only with as many more velocity.points that the spacing stays"
"""Of a share in the outermost velocities: a wider box alone would make a coarse grid coarser."""
