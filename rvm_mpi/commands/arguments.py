"""What the commands' arguments have in common."""

from __future__ import annotations

import argparse
import re
from math import inf, nan

EXIT_STATUS = (
    "exit status: 0 done; 2 the request is wrong, nothing was run; 3 the run failed; "
    "75 stopped early with a checkpoint, go on with --restart"
)


def add_set(parser: argparse.ArgumentParser) -> None:
    """The option `--set`."""
    parser.add_argument(
        "--set", metavar="KEY=VALUE", action="append", default=[],
        help="override one key of the job file, for instance collision.restitution=0.75 (TOML syntax)",
    )  # fmt: skip


def count(text: str) -> int:
    """A whole number above 0."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return int(text)


def tolerance(text: str) -> float:
    """A number from 0 on."""
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not 0.0 <= value < inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 on")
    return value


def walltime(text: str) -> float:
    """Seconds of HH:MM:SS or D-HH:MM:SS."""
    match = re.fullmatch(r"(?:(\d+)-)?(\d+):([0-5]\d):([0-5]\d)", text)
    seconds = 0
    if match:
        days, hours, minutes, rest = (int(part or 0) for part in match.groups())
        seconds = ((days * 24 + hours) * 60 + minutes) * 60 + rest
    if seconds == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time HH:MM:SS above zero")
    return float(seconds)
