"""The progress line of a run: a bar on a terminal, plain lines in a log."""

from __future__ import annotations

import time as clock
from collections import deque
from collections.abc import Callable
from math import isfinite, prod
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job
    from rvm_mpi.output.rundir import Log

FIRST_STEPS = 3  # always reported, so that a bad start is seen at once
INTERVAL = 10.0  # seconds between lines; from ten minutes on a sixtieth of the time so far
RECENT = 60.0  # seconds over which the present speed is measured


class Progress:
    """Reports on the steps of a run; for rank 0.

    Parameters
    ----------
    job : `time.end`, `time.max_steps` and the sizes of the grids are used
    stream : where to report, such as sys.stderr; None reports nothing there
    log : a second stream that always gets plain lines, such as run.log
    ranks, stages : cores in use and stages of a time step, for the last line's throughput
    start : step and time at which a restarted run begins
    stretched : function of time that grows as the number of steps (`time_limits.stretched_time`); time itself if None
    now : clock in seconds, replaced in tests
    """

    def __init__(
        self,
        job: Job,
        stream: TextIO | None,
        log: TextIO | Log | None = None,
        ranks: int = 1,
        stages: int = 2,
        start: tuple[int, float] = (0, 0.0),
        stretched: Callable[[float], float] | None = None,
        now: Callable[[], float] = clock.perf_counter,
    ):
        self._end = float(job.time.end)
        self._stretched = stretched or (lambda time: time)
        self._max_steps = job.time.max_steps
        self._cells = prod(job.space.cells) * prod(job.velocity.points)
        self._ranks, self._stages = ranks, stages
        self._now = now
        self._begin = self._last_line = now()
        self._first_step = self._step = start[0]
        self._time = start[1]
        self._recent: deque[tuple[float, int, float]] = deque([(self._begin, *start)])
        terminal = stream is not None and stream.isatty()
        self._lines = [s for s in (None if terminal else stream, log) if s is not None]
        self._bar: Any = None
        if terminal:
            from tqdm import tqdm

            bar_format = "{percentage:3.0f}%|{bar:16}| {desc}"
            self._bar = tqdm(
                total=self._end, initial=start[1], file=stream, bar_format=bar_format, dynamic_ncols=True
            )

    def update(
        self,
        step: int,
        time: float,
        dt: float,
        mass_error: float,
        min_g: float,
        temperature_range: tuple[float, float],
        cells_per_second: float | None = None,
    ):
        """Report a finished step, if it is time to.

        Parameters
        ----------
        step, time, dt : its number, the time it reached, its length
        mass_error : relative
        min_g : smallest value of g
        temperature_range : smallest and largest temperature
        cells_per_second : phase-space cells per second; measured here, over the last minute, if None
        """
        now = self._now()
        self._step, self._time = step, time
        self._recent.append((now, step, time))
        while len(self._recent) > 2 and self._recent[1][0] < now - RECENT:
            self._recent.popleft()
        due = now - self._last_line >= max(INTERVAL, (now - self._begin) / 60)
        first = step - self._first_step <= FIRST_STEPS
        last = time >= self._end or step == self._max_steps
        if self._bar is None and not (due or first or last):
            return
        speed = self._speed() if cells_per_second is None else cells_per_second
        state = (
            f"dt = {dt:.3g}, {duration(self._time_left())} left, mass error {mass_error:.1e}, "
            f"min g {min_g:.1e}, T {temperature_range[0]:.3g} to {temperature_range[1]:.3g}, "
            f"{_count(speed)} cells/s"
        )
        where = f"step {step}, t = {time:.4g} of {self._end:g}"
        if self._bar is not None:
            self._bar.set_description_str(f"{where}, {state}", refresh=False)
            self._bar.update(min(time, self._end) - self._bar.n)
            if last:
                self._bar.refresh()
        if due or first or last:
            self._last_line = now
            self._say(f"{where} ({100 * time / self._end:.1f} %), {state}")

    def close(self):
        """End the bar and say in one last line what was done and how fast."""
        if self._bar is not None:
            self._bar.refresh()
            self._bar.close()
        elapsed = max(self._now() - self._begin, 1e-9)
        steps = self._step - self._first_step
        rate = self._cells * steps * self._stages / elapsed
        line = (
            f"{steps} steps to t = {self._time:g} in {duration(elapsed)}: {_count(rate)} phase-space cell "
            f"stages per second, {_count(rate / self._ranks)} per core on {self._ranks}"
        )
        if self._bar is not None:
            self._bar.fp.write(line + "\n")
            self._bar.fp.flush()
        self._say(line)

    def _say(self, line: str):
        for stream in self._lines:
            stream.write(line + "\n")
            stream.flush()

    def _speed(self) -> float:
        """Phase-space cells per second, each counted once a step."""
        (wall0, step0, _), (wall1, step1, _) = self._recent[0], self._recent[-1]
        return self._cells * (step1 - step0) / max(wall1 - wall0, 1e-9)

    def _time_left(self) -> float:
        """Seconds to the end at the recent speed, whichever end comes first; steps grow as a gas cools."""
        (wall0, step0, time0), (wall1, step1, time1) = self._recent[0], self._recent[-1]
        wall = wall1 - wall0
        before, now, end = (self._stretched(time) for time in (time0, time1, self._end))
        left = wall * (end - now) / (now - before) if now > before else float("inf")
        if self._max_steps and step1 > step0:
            left = min(left, wall * (self._max_steps - step1) / (step1 - step0))
        return max(left, 0.0)


def duration(seconds: float) -> str:
    """Such as "7.3 s", "4:05 min" or "12:04 h"."""
    if not isfinite(seconds):
        return "unknown time"
    if seconds < 59.95:
        return f"{seconds:.1f} s"
    if seconds < 3599.5:
        minutes, rest = divmod(round(seconds), 60)
        return f"{minutes}:{rest:02d} min"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours}:{minutes:02d} h"


def _count(value: float) -> str:
    """Three digits with a metric prefix, such as "431 M"."""
    for size, prefix in ((1e12, " T"), (1e9, " G"), (1e6, " M"), (1e3, " k")):
        if value >= 0.9995 * size:
            return f"{value / size:.3g}{prefix}"
    return f"{value:.3g}"
