"""What a run watches after each step: its balances, and how much of g is in the outermost velocities.

A warning is said once when a quantity passes its threshold, and again each time it has grown by ten.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from rvm_mpi.diagnostics import COLUMNS, Watched

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

AGAIN = 10.0
"""Growth after which a warning is repeated."""


def watched(job: Job) -> dict[str, Watched]:
    """The columns of the history that a run of this job watches, balances first."""
    found = [(column.name, column.watched) for column in COLUMNS if column.watched is not None]
    found.sort(key=lambda one: one[1].threshold != "balance")
    return {name: what for name, what in found if job.scheme.conservative or not what.conservative}


def promised(job: Job) -> tuple[str, ...]:
    """Columns of the history that a run of this job keeps to round-off.

    Mass always; momentum and energy where the moments are carried and g is corrected to them.
    """
    return tuple(name for name, what in watched(job).items() if what.threshold == "balance")


class Watch:
    """Compares the rows of the history with the thresholds of a job's `[watch]`.

    Parameters
    ----------
    job : Job
    """

    def __init__(self, job: Job) -> None:
        self._watched = watched(job)
        # one is no threshold: where g is negative in places the outermost velocities can hold more than all
        warning, self._stop = (x if x < 1.0 else math.inf for x in (job.watch.box_warning, job.watch.box_stop))
        thresholds = {"balance": job.watch.balance, "box_warning": warning}
        #: size above which a quantity is spoken of next
        self._next = {name: thresholds[what.threshold] for name, what in self._watched.items()}

    def warnings(self, row: Mapping[str, float]) -> list[str]:
        """Lines on what has passed its threshold with this row, or grown by ten since it was spoken of."""
        lines = []
        for name, threshold in self._next.items():
            size = _size(name, row)
            if size <= threshold:
                continue
            self._next[name] = AGAIN * size
            what = self._watched[name]
            cure = _CURE if what.threshold == "box_warning" else ""
            lines.append(f"{what.words.format(size)} in step {row['step']:.0f} at t = {row['time']:.6g}{cure}")
        return lines

    def reason_to_stop(self, row: Mapping[str, float]) -> str:
        """Why the run must not go on with this row; empty if it may."""
        for name, what in self._watched.items():
            if what.threshold == "box_warning" and _size(name, row) > self._stop:
                return f"{what.words.format(_size(name, row))}, above watch.box_stop = {self._stop:g}"
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


_CURE = ": a wider velocity.half_width holds it, but only with as many more velocity.points that the spacing stays"
"""Of a share in the outermost velocities: a wider box alone would make a coarse grid coarser."""
