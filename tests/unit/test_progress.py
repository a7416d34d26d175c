"""The progress line: plain in a log, a bar on a terminal, seldom enough, with the right estimates."""

import io
from types import SimpleNamespace

import numpy as np
import pytest

from rvm_mpi.run.progress import Progress, _count, duration


class Clock:
    def __init__(self):
        self.seconds = 100.0

    def __call__(self):
        return self.seconds


class Terminal(io.StringIO):
    def isatty(self):
        return True


def job(end=10.0, max_steps=None):
    return SimpleNamespace(
        time=SimpleNamespace(end=end, max_steps=max_steps),
        space=SimpleNamespace(cells=(10, 10)),
        velocity=SimpleNamespace(points=(10, 10, 10)),
    )


def run(progress, clock, steps, seconds, dt, first=1, time=0.0):
    for step in range(first, first + steps):
        clock.seconds += seconds
        time += dt
        progress.update(step, time, dt, 1.5e-15, -2e-12, (0.25, 99.5))
    return time


def test_a_line_says_everything():
    clock, out = Clock(), io.StringIO()
    run(Progress(job(), out, now=clock), clock, steps=1, seconds=0.5, dt=0.25)
    line = out.getvalue()
    assert line.count("\n") == 1
    for part in (
        "step 1, t = 0.25 of 10 (2.5 %)",
        "dt = 0.25",
        "19.5 s left",
        "mass error 1.5e-15",
        "min g -2.0e-12",
        "T 0.25 to 99.5",
        "200 k cells/s",
    ):
        assert part in line


def test_time_left_knows_that_steps_grow():
    """Steps that grow as 1 + t, a second each: from t = 0 to e^2 - 1 in 200 of them, whenever one asks."""
    clock, out = Clock(), io.StringIO()
    end, growth = np.expm1(2.0), np.expm1(0.01)
    progress = Progress(job(end=end), out, stretched=np.log1p, now=clock)
    time = 0.0
    for step in range(1, 4):
        dt = (1.0 + time) * growth
        time = run(progress, clock, steps=1, seconds=1.0, dt=dt, first=step, time=time)
        assert f", {duration(200.0 - step)} left" in out.getvalue().splitlines()[-1]


def test_first_steps_then_every_ten_seconds_then_the_last():
    clock, out = Clock(), io.StringIO()
    run(Progress(job(end=1000.0), out, now=clock), clock, steps=1000, seconds=0.125, dt=1.0)
    steps = [int(line.split(",")[0].split()[1]) for line in out.getvalue().splitlines()]
    assert steps[:4] == [1, 2, 3, 83]
    assert steps[-1] == 1000
    assert len(steps) == 3 + 12 + 1


def test_a_long_run_does_not_fill_its_log():
    clock, out = Clock(), io.StringIO()
    run(Progress(job(end=1e6), out, now=clock), clock, steps=24 * 3600, seconds=1.0, dt=0.1)
    assert 100 < out.getvalue().count("\n") < 500


def test_time_left_follows_the_recent_speed():
    clock, out = Clock(), io.StringIO()
    progress = Progress(job(end=1000.0), out, now=clock)
    time = run(progress, clock, steps=100, seconds=10.0, dt=0.1)
    run(progress, clock, steps=100, seconds=1.0, dt=1.0, first=101, time=time)
    last = out.getvalue().splitlines()[-1]
    assert "t = 100 of 1000" in last
    assert "15:00 min left" in last  # 900 at one a second


def test_max_steps_is_an_end_too():
    clock, out = Clock(), io.StringIO()
    run(Progress(job(end=1e9, max_steps=5), out, now=clock), clock, steps=5, seconds=2.0, dt=0.1)
    lines = out.getvalue().splitlines()
    assert "8.0 s left" in lines[0]
    assert lines[-1].startswith("step 5,")
    assert "0.0 s left" in lines[-1]


def test_last_line_has_the_throughput_in_all_and_per_core():
    clock, out = Clock(), io.StringIO()
    progress = Progress(job(), out, ranks=4, stages=2, start=(100, 2.0), now=clock)
    run(progress, clock, steps=20, seconds=0.5, dt=0.25, first=101, time=2.0)
    progress.close()
    expected = "20 steps to t = 7 in 10.0 s: 400 k phase-space cell stages per second, 100 k per core on 4"
    assert out.getvalue().splitlines()[-1] == expected


def test_the_given_speed_is_shown():
    clock, out = Clock(), io.StringIO()
    progress = Progress(job(), out, now=clock)
    clock.seconds += 1.0
    progress.update(1, 0.1, 0.1, 0.0, 0.0, (1.0, 1.0), cells_per_second=431e6)
    assert "431 M cells/s" in out.getvalue()


def test_a_bar_only_on_a_terminal_and_plain_lines_in_the_log():
    clock, terminal, log = Clock(), Terminal(), io.StringIO()
    progress = Progress(job(), terminal, log=log, now=clock)
    run(progress, clock, steps=40, seconds=0.5, dt=0.25)
    progress.close()
    assert "\r" in terminal.getvalue()
    assert "100%|" in terminal.getvalue()
    assert terminal.getvalue().splitlines()[-1].startswith("40 steps")
    assert "\r" not in log.getvalue()
    assert "|" not in log.getvalue()
    assert log.getvalue().splitlines()[-1].startswith("40 steps")


def test_quiet():
    clock = Clock()
    progress = Progress(job(), None, now=clock)
    run(progress, clock, steps=3, seconds=1.0, dt=1.0)
    progress.close()


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.04, "0.0 s"),
        (59.94, "59.9 s"),
        (59.96, "1:00 min"),
        (245, "4:05 min"),
        (3599.4, "59:59 min"),
        (3599.6, "1:00 h"),
        (43440, "12:04 h"),
        (float("inf"), "unknown time"),
    ],
)
def test_durations(seconds, text):
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("value", "text"), [(0, "0"), (999, "999"), (999.7, "1 k"), (4.313e8, "431 M"), (2.5e9, "2.5 G")]
)
def test_counts(value, text):
    assert _count(value) == text
