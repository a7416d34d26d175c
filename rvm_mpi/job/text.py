"""Reading a job file's text, and the one line that says what is wrong with it."""

from __future__ import annotations

import difflib
import os
import re
import stat
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

LARGEST_FILE = 1_000_000
"""Bytes; a job file is a page of text, anything larger is some other file."""


class JobError(ValueError):
    """The request is wrong; ``str()`` is one line naming file, key, value and what is allowed."""

    def __init__(self, message: str):
        super().__init__(one_line(message))


class JobFileError(JobError):
    """The job file cannot be read here (each rank reads it, so one machine may fail alone)."""


class KeyProblem(Exception):
    """What is wrong with one key; `line()` puts it into words."""

    def __init__(self, key: str, wrong: str, value: Any = None, allowed: str = "", nearest: str = ""):
        super().__init__(key)
        self.key, self.wrong, self.value, self.allowed, self.nearest = key, wrong, value, allowed, nearest

    def line(self, overrides: Iterable[str] = ()) -> str:
        """`key: what is wrong (value ...; allowed ...); did you mean "..."?`"""
        details = []
        if self.value is not None:
            details.append(f"value {shown(self.value)}")
        if self.allowed:
            details.append(f"allowed {self.allowed}")
        text = f"{self.key}: " if self.key else ""
        text += self.wrong + (f" ({'; '.join(details)})" if details else "")
        if self.nearest:
            text += f'; did you mean "{self.nearest}"?'
        if any(self.key == key or self.key.startswith(key + ".") for key in overrides):
            text += " [from --set]"
        return text


def one_line(text: str) -> str:
    """The text without anything that could break the line or a terminal."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def shown(value: Any, longest: int = 60) -> str:
    """A value as it would stand in a TOML file, cut to a readable length."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, str):
        text = f'"{value[: longest + 1]}"'
    elif isinstance(value, Mapping):
        text = "{" + ", ".join(f"{key} = {shown(item)}" for key, item in list(value.items())[:8]) + "}"
    elif isinstance(value, (list, tuple)):
        text = "[" + ", ".join(shown(item) for item in value[:8]) + (", ..." if len(value) > 8 else "") + "]"
    elif isinstance(value, int) and abs(value) >= 10**longest:
        text = "an integer of more than 60 digits"
    else:
        text = str(value)
    return text if len(text) <= longest + 2 else text[:longest] + "..."


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word that looks like a slip of this one, or an empty string."""
    known = list(known)
    folded = {k.lower().replace("-", "_"): k for k in known}
    found = difflib.get_close_matches(str(word).lower().replace("-", "_"), folded, n=1, cutoff=0.6)
    return folded[found[0]] if found else ""


def read_text(path: str | os.PathLike[str]) -> str:
    """The text of a job file; JobFileError in one line when there is none to read."""
    name = os.fspath(path)
    try:
        status = Path(name).stat()
        if stat.S_ISDIR(status.st_mode):
            raise JobFileError(f"{name}: is a directory, not a job file")
        if not stat.S_ISREG(status.st_mode):
            raise JobFileError(f"{name}: is not a regular file")
        if status.st_size > LARGEST_FILE:
            raise JobFileError(f"{name}: {status.st_size} bytes is too large for a job file")
        data = Path(name).read_bytes()
    except FileNotFoundError:
        hint = nearest(Path(name).name, _names_beside(Path(name)))
        raise JobFileError(f"{name}: no such file" + (f'; did you mean "{hint}"?' if hint else "")) from None
    except (OSError, ValueError) as error:
        if isinstance(error, JobError):
            raise
        raise JobFileError(f"{name}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise JobFileError(f"{name}: not a TOML file: not UTF-8 text (line {line})") from None


def _names_beside(path: Path) -> list[str]:
    try:
        return [p.name for p in path.parent.iterdir() if p.suffix == ".toml"]
    except OSError:
        return []


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """The tables of a TOML text; JobError with the line number when it is broken."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise JobError(f"{name}: not valid TOML: nested too deeply") from None
    except ValueError as error:
        raise JobError(f"{name}: not valid TOML: {error}") from None


def apply_override(tables: dict[str, Any], override: str) -> str:
    """Set one key of the tables from ``KEY=VALUE``, the value in TOML syntax; returns the key."""
    if any("\ud800" <= c <= "\udfff" for c in override):  # bytes that the locale does not know
        try:
            override = os.fsencode(override).decode()
        except UnicodeError:
            raise JobError(f"--set {override}: not UTF-8 text") from None
    key, equals, text = override.partition("=")
    key = key.strip()
    if not equals or not re.fullmatch(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*", key):
        raise JobError(f"--set {override}: must be KEY=VALUE (for instance --set time.end=1.0)")
    value = _override_value(key, text.strip())
    *parents, last = key.split(".")
    table: Any = tables
    for depth, parent in enumerate(parents):
        table = table.setdefault(parent, {})
        if not isinstance(table, dict):
            path = ".".join(parents[: depth + 1])
            raise JobError(f"--set {override}: {path} is not a table in the job file (value {shown(table)})")
    table[last] = value
    return key


def _override_value(key: str, text: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        parsed = {}
    if set(parsed) != {"value"}:
        hint = ""
        if re.fullmatch(r"[A-Za-z][^\"'\n]*", text):
            hint = f"; text needs quotes: --set '{key}=\"{text}\"'"
        raise JobError(f"--set {key}={text}: the value is not TOML{hint}")
    return parsed["value"]


def plain(value: Any) -> Any:
    """A copy in the types TOML has: numpy numbers and arrays, paths and tuples become plain ones."""
    if isinstance(value, Mapping):
        return {key if isinstance(key, str) else str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return value
