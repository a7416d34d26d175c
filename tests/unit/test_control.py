"""When a run stops and when a checkpoint is due: a clock in the test's hand, real signals."""

import os
import signal

import pytest

from rvm_mpi.run.control import SIGNALS, Control, Decision


class Clock:
    def __init__(self):
        self.time = 100.0

    def __call__(self):
        return self.time


class Ranks:
    """A domain of one rank, or one whose other ranks say `others`."""

    def __init__(self, rank=0, others=()):
        self.rank, self.others = rank, others

    def maximum(self, *values):
        return [max(v, o) for v, o in zip(values, self.others or values)]


@pytest.fixture
def now():
    return Clock()


def test_nothing_happens_by_itself(tmp_path, now):
    control = Control(tmp_path, now=now)
    control.start(0.0)
    for _ in range(5):
        now.time += 1000.0
        assert control.agree(Ranks()) == Decision("", False)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_leaves_a_note_and_nothing_else(tmp_path, now, number):
    own = signal.getsignal(number)
    before = signal.default_int_handler if own is signal.SIG_IGN else own  # nohup or a pipeline may run the tests
    signal.signal(number, before)
    with Control(tmp_path, now=now) as control:
        control.start(0.0)
        assert control.agree(Ranks()) == Decision()
        os.kill(os.getpid(), number)
        assert control.agree(Ranks()) == Decision(signal.Signals(number).name, True)
    assert signal.getsignal(number) == before
    signal.signal(number, own)


def test_what_is_ignored_as_nohup_does_stays_ignored(tmp_path, now):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Control(tmp_path, now=now) as control:
            control.start(0.0)
            os.kill(os.getpid(), signal.SIGHUP)
            assert control.agree(Ranks()) == Decision()
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_signal_to_another_rank_stops_this_one(tmp_path, now):
    control = Control(tmp_path, now=now)
    assert control.agree(Ranks(others=(signal.SIGUSR1, 0, 0, 0))) == Decision("SIGUSR1", True)


def test_checkpoints_by_the_clock(tmp_path, now):
    control = Control(tmp_path, checkpoint_every=60.0, now=now)
    now.time += 50.0  # starting up does not count
    control.start(0.0)
    due = []
    for _ in range(6):
        now.time += 25.0
        due.append(control.agree(Ranks()).checkpoint)
        if due[-1]:
            now.time += 10.0
            control.took_checkpoint()
    assert due == [False, False, True, False, False, True]


def test_only_the_clock_of_rank_0_counts(tmp_path, now):
    control = Control(tmp_path, walltime=1.0, checkpoint_every=1.0, now=now)
    (tmp_path / "stop").touch()
    now.time += 1e6
    assert control.agree(Ranks(rank=1)) == Decision()


def test_it_stops_before_the_wall_clock_limit(tmp_path, now):
    """With room for two steps and two checkpoints, at the speed they had."""
    control = Control(tmp_path, walltime=100.0, checkpoint_every=20.0, now=now)
    control.start(8e8)  # 8 s at first
    stopped = None
    while stopped is None:
        now.time += 3.0
        decision = control.agree(Ranks())
        if decision.stop:
            stopped = now.time - 100.0
        elif decision.checkpoint:
            now.time += 5.0
            control.took_checkpoint()
    assert decision == Decision("the wall-clock limit", True)
    assert 100.0 - 2 * (3.0 + 5.0) - 2.0 - 3.0 - 5.0 <= stopped <= 100.0 - 2 * (3.0 + 5.0) - 2.0 + 3.0


def test_a_limit_that_is_over_still_gives_a_step(tmp_path, now):
    control = Control(tmp_path, walltime=10.0, now=now)
    now.time += 50.0
    control.start(0.0)
    now.time += 1.0
    assert control.agree(Ranks()).stop == "the wall-clock limit"


def test_the_stop_file(tmp_path, now):
    control = Control(tmp_path, now=now)
    control.start(0.0)
    assert not control.agree(Ranks()).stop
    (tmp_path / "stop").touch()
    now.time += 1.0
    assert control.agree(Ranks()) == Decision(f"the file {tmp_path / 'stop'}", True)
    control.forget_stop_file()
    assert not (tmp_path / "stop").exists()
    control.forget_stop_file()
