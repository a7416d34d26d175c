"""Checks and defaults of `[time]`, and the times of `[output]` one by one."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from math import exp, log
from typing import Any

from rvm_mpi.job.schema import MOST_SNAPSHOTS, Output, SpacedTimes, Time
from rvm_mpi.job.text import KeyProblem
from rvm_mpi.job.updates import updated


def resolve_time(time: Time) -> Time:
    """Courant number or fixed step, one of the two."""
    if time.dt is None:
        return updated(time, cfl=0.5 if time.cfl is None else time.cfl)
    if time.cfl is not None:
        raise KeyProblem("time.dt", "time.dt and time.cfl exclude each other", time.dt, "one of the two")
    if time.dt > time.end:
        raise KeyProblem("time.dt", "longer than the run", time.dt, f"at most time.end = {time.end}")
    return time


def resolve_output(output: Output, end: float) -> Output:
    """The times of all snapshots, whichever way they were said; `end` is time.end."""
    if output.every is not None:
        if output.times is not None:
            raise KeyProblem(
                "output.every", "output.times and output.every exclude each other", output.every, "one of the two"
            )
        return updated(output, times=_times_every(output.every, end), every=None)
    if output.times is None:
        return updated(output, times=(end,))
    times: Any = output.times
    if isinstance(times, SpacedTimes):
        times = _spaced_times(times, end)
    if max(times) > end:
        raise KeyProblem("output.times", "after the end", max(times), f"0 to time.end = {end}")
    if any(b <= a for a, b in pairwise(times)):
        raise KeyProblem("output.times", "not rising", times, "each time once, in rising order")
    return updated(output, times=times)


def _times_every(every: float, end: float) -> tuple[float, ...]:
    """0, every, 2 every, ... and the end, as decimal numbers: 0.3 and not three times the binary 0.1."""
    if every > end:
        raise KeyProblem("output.every", "longer than the run", every, f"at most time.end = {end}")
    if end / every > MOST_SNAPSHOTS - 1:
        raise KeyProblem("output.every", f"more than {MOST_SNAPSHOTS} snapshots", every, "a longer time")
    step, last = Fraction(repr(every)), Fraction(repr(end))
    whole = int(last / step)
    if last - whole * step <= step / 10**9:  # the end itself, but for rounding
        whole -= 1
    return (*(float(k * step) for k in range(whole + 1)), end)


def _spaced_times(given: SpacedTimes, end: float) -> tuple[float, ...]:
    """So many times from one to another. Of those between twelve digits: the same numbers on every machine."""
    first, last = given.start, given.to
    if last > end:
        raise KeyProblem("output.times.to", "after the end", last, f"at most time.end = {end}")
    if not first < last:
        raise KeyProblem("output.times.from", "not below output.times.to", first, f"below {last}")
    if given.spacing == "log" and first == 0.0:
        raise KeyProblem("output.times.from", 'a logarithm has no 0 (spacing = "log")', first, "a number > 0")
    shares = [k / (given.count - 1) for k in range(1, given.count - 1)]
    if given.spacing == "log":
        between = [exp(log(first) + share * (log(last) - log(first))) for share in shares]
    else:
        between = [first + share * (last - first) for share in shares]
    times = (first, *(float(f"{time:.12g}") for time in between), last)
    if any(b <= a for a, b in pairwise(times)):
        raise KeyProblem("output.times.count", "too many for so short a span", given.count)
    return times
