"""When a run stops early and when it writes a checkpoint: signals, the wall-clock limit, a stop file.

Nothing here interrupts a step. Signal handlers leave a note, and after each step all ranks agree on one answer.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rvm_mpi.grid.domain import Domain

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2, signal.SIGXCPU)
"""End a run with a checkpoint: the last one says that a limit of processor time is near."""
STOP_FILE = "stop"
#: seconds between looks at the stop file
LOOK_EVERY = 0.5
#: bytes per second that a first checkpoint is expected to be written with
CAUTIOUS_SPEED = 100e6


@dataclass(frozen=True)
class Decision:
    """What all ranks do after a step.

    Attributes
    ----------
    stop : str
        Why the run stops here; empty if it goes on.
    checkpoint : bool
        Whether a checkpoint is due.
    """

    stop: str = ""
    checkpoint: bool = False


class Control:
    """Decides, together with the other ranks, whether to go on. A context: handlers are there while it is open.

    Parameters
    ----------
    directory : Path
        The run directory; a file `stop` in it ends the run.
    walltime : float, optional
        Seconds from now by which the run has to have written its checkpoint and ended.
    checkpoint_every : float
        Seconds between checkpoints.
    now : callable
        The clock.
    """

    def __init__(
        self,
        directory: Path,
        walltime: float | None = None,
        checkpoint_every: float = float("inf"),
        now: Callable[[], float] = clock.monotonic,
    ) -> None:
        self._now, self._begin = now, now()
        self._walltime, self._every = walltime, checkpoint_every
        self._stop_file = directory / STOP_FILE
        self._next_look = self._begin
        self._signal = 0
        self._before: dict[int, Any] = {}
        self._last_step = self._last_checkpoint = self._begin
        self._longest = self._cost = 0.0

    def __enter__(self) -> Control:
        if threading.current_thread() is not threading.main_thread():
            return self
        for number in SIGNALS:
            if number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN:
                continue  # nohup: the run is to outlive its terminal
            self._before[number] = signal.signal(number, self._note)
            signal.siginterrupt(number, False)  # a signal must not cut a write short either
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._before.clear()

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self._signal = number

    def start(self, checkpoint_bytes: float) -> None:
        """The first step comes next; a checkpoint will have so many bytes."""
        self._cost = checkpoint_bytes / CAUTIOUS_SPEED
        self._last_step = self._last_checkpoint = self._now()

    def took_checkpoint(self) -> None:
        """A checkpoint was written, beginning with the last decision."""
        now = self._now()
        self._cost = now - self._last_step
        self._last_step = self._last_checkpoint = now

    def forget_stop_file(self) -> None:
        """Remove the stop file: it has done its work. For rank 0."""
        with contextlib.suppress(OSError):
            self._stop_file.unlink()

    def agree(self, domain: Domain) -> Decision:
        """One answer for all ranks, after a step; collective. Clock and stop file are those of rank 0."""
        late = found = due = 0.0
        if domain.rank == 0:
            now = self._now()
            self._longest = max(now - self._last_step, 0.7 * self._longest)
            self._last_step = now
            late, found = float(self._too_late(now)), float(self._finds_stop_file(now))
            due = float(now - self._last_checkpoint >= self._every)
        number, late, found, due = domain.maximum(float(self._signal), late, found, due)
        if domain.rank != 0:
            self._last_step = self._now()
        if number > 0.0:
            return Decision(signal.Signals(int(number)).name, True)
        if late > 0.0:
            return Decision("the wall-clock limit", True)
        if found > 0.0:
            return Decision(f"the file {self._stop_file}", True)
        return Decision("", due > 0.0)

    def _too_late(self, now: float) -> bool:
        """Whether another step, a checkpoint and the end may not fit in what is left."""
        if self._walltime is None:
            return False
        reserve = 2.0 * (self._longest + self._cost) + min(5.0, 0.02 * self._walltime)
        return now + reserve >= self._begin + self._walltime

    def _finds_stop_file(self, now: float) -> bool:
        if now < self._next_look:
            return False
        self._next_look = now + LOOK_EVERY
        return self._stop_file.exists()
