"""Small things that every file of a run needs of the disk."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def named(path: str | Path) -> Iterator[None]:
    """An error of the disk names the file, which Python leaves out when writing fails after opening."""
    try:
        yield
    except OSError as error:
        raise OSError(f"{path} cannot be written: {error.strerror or error}") from error


def flush_to_disk(path: Path) -> None:
    """Return when a file, or the list of files of a folder, is on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def free_name(path: Path, suffix: str = "") -> Path:
    """The first of NAME-1, NAME-2, ... that does not exist."""
    number = 1
    while (candidate := path.with_name(f"{path.name}-{number}{suffix}")).exists():
        number += 1
    return candidate
