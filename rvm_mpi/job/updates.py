"""How a table of a job is written out: a copy with other values, and vectors with an entry for each direction."""

from __future__ import annotations

from typing import Any, TypeVar

from rvm_mpi.job.section import Section, Vector
from rvm_mpi.job.text import KeyProblem

AXES = ("x", "y", "z")

_S = TypeVar("_S", bound=Section)


def updated(section: _S, **values: Any) -> _S:
    """A copy with other values."""
    return section.model_copy(update=values)


def vector(key: str, value: Vector | None, entries: int, default: float, what: str) -> Vector:
    """A vector of so many entries, or the default in each."""
    if value is None:
        return (default,) * entries
    if len(value) != entries:
        raise KeyProblem(
            key,
            "wrong number of entries",
            value,
            f"{entries}, one per {what} dimension" if entries else "none",
        )
    return value
