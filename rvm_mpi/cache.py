"""The user's cache directory: what costs time to make is kept there between runs, and may be deleted at any time."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any


def cache_directory() -> Path:
    """Where things are kept, by the XDG base directory specification; it need not exist.

    Raises
    ------
    RuntimeError
        Where the user has no home directory.
    """
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (given if given.is_absolute() else Path.home() / ".cache") / "rvm_mpi"


def write_whole(path: Path, *parts: Any) -> None:
    """Write bytes to a file that appears whole or not at all, in place of one that may be there.

    Raises
    ------
    OSError
        The directory cannot be written or the disk is full; nothing is left behind.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent)
    try:
        with open(handle, "wb") as file:  # noqa: PTH123 a descriptor, not a path
            for part in parts:
                file.write(part)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
