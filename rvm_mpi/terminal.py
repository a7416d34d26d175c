"""Standard output and standard error, whoever listens there and whatever characters he can show.

A command's answer goes to standard output, what it says beside it to standard error. A reader that goes away (`| head`,
a closed terminal) ends neither; a character that cannot be shown is replaced.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
from typing import Any


class _Forgiving(io.FileIO):
    """A file that drops what it cannot write: nobody reads it any more, or its disk is full."""

    def write(self, data: Any, /) -> int:
        try:
            written = super().write(data)
        except OSError:
            written = None
        return len(data) if written is None else written


def prepare() -> None:
    """Make the streams of a command safe; streams that someone has put in their place (a test) stay as they are."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:  # closed: the next file to be opened would get its number, and what others say in it
            os.open(os.devnull, os.O_RDWR)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w", closefd=False)
    if sys.stdout is sys.__stdout__ and isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")
    if sys.stderr is None or sys.stderr is sys.__stderr__:
        encoding = getattr(sys.stderr, "encoding", "utf-8")
        raw = io.BufferedWriter(_Forgiving(2, "w", closefd=False))
        sys.stderr = io.TextIOWrapper(raw, encoding=encoding, errors="replace", line_buffering=True)


def answer(text: str) -> None:
    """Print a command's answer; a reader that has seen enough is no failure.

    Raises
    ------
    OSError
        If it cannot be written for another reason, such as a full disk.
    """
    try:
        print(text, flush=True)
    except BrokenPipeError:
        _turn_away()
    except OSError as error:
        _turn_away()
        raise OSError(f"standard output cannot be written: {error.strerror}") from None


def tell(line: str) -> None:
    """Say a line on standard error, after all that was answered."""
    flush()
    with contextlib.suppress(OSError):  # nobody listens any more
        print(line, file=sys.stderr, flush=True)


def flush() -> None:
    """Write out what standard output still holds, if anyone reads it."""
    try:
        sys.stdout.flush()
    except OSError:
        _turn_away()


def _turn_away() -> None:
    """Keep Python from writing the rest once more at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
