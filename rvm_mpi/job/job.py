"""The job file: read, checked, every default written out.

A job passes two gates: the models of `rvm_mpi.job.schema` say, table by table, which keys there are, their
types and ranges; `rvm_mpi.job.checks.resolve` checks what depends on several keys and writes the defaults
out, so that a `Job` leaves nothing open. Whatever is wrong becomes one line, a `JobError`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import tomli_w
from pydantic import BaseModel, Field, PrivateAttr, ValidationError

from rvm_mpi.job.checks import resolve
from rvm_mpi.job.initial import INITIAL_STATES, Initial
from rvm_mpi.job.schema import FORMS, Boundary, Collision, Fluid, Output, Scaling, Scheme, Space, Time, Velocity, Watch
from rvm_mpi.job.section import Section, Text
from rvm_mpi.job.text import (
    JobError,
    JobFileError,
    KeyProblem,
    apply_override,
    nearest,
    parse_toml,
    plain,
    read_text,
    shown,
)

__all__ = ["Boundary", "Job", "JobError", "JobFileError"]


INSTEAD = {"output.every": "output.times", "output.times": "output.every"}
"""Keys of a file that make way when the other one is set on the command line."""


class Job(Section):
    """A valid job with every default written out. Made by `from_file` or `from_dict`, equal by its keys."""

    title: Text = Field("", description="text in quotes")
    space: Space = Field(description="a table with cells, lower, upper, boundary")
    velocity: Velocity = Field(description="a table with points, half_width")
    scaling: Scaling = Field(default=Scaling(), description="a table with kind, synchronise")
    collision: Collision = Field(description="a table with operator and its keys")
    scheme: Scheme = Field(default=Scheme(), description="a table with drift, conservative")
    fluid: Fluid = Field(default=Fluid(), description="a table with enabled")
    initial: Initial = Field(description="a table with state and its keys")
    time: Time = Field(description="a table with end, cfl, max_steps, dt")
    output: Output = Field(default=Output(), description="a table with times or every, checkpoint_every, marginals")
    watch: Watch = Field(default=Watch(), description="a table with box_warning, box_stop, balance")

    _name: str = PrivateAttr("job")
    _text: str = PrivateAttr("")

    @property
    def name(self) -> str:
        """Stem of the job file's name."""
        return self._name

    @property
    def text(self) -> str:
        """The job file's text as it was read; for a job made from a dictionary, that of `to_toml`."""
        return self._text

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Job) and _keys(self) == _keys(other)

    def __hash__(self) -> int:
        return hash(self.to_toml())

    @classmethod
    def from_file(cls, path: str | os.PathLike[str], overrides: Iterable[str] = ()) -> Job:
        """Read a TOML job file and set ``KEY=VALUE`` overrides in it; JobError if it is not valid.

        Paths in the file are relative to its folder, paths in overrides to the working directory.
        """
        text = read_text(path)
        tables = parse_toml(text, os.fspath(path))
        _place_paths(tables, path)
        keys = [apply_override(tables, override) for override in overrides]
        for key in keys:  # what is said last holds
            if key in INSTEAD and INSTEAD[key] not in keys and isinstance(tables["output"], dict):
                tables["output"].pop(INSTEAD[key].split(".")[1], None)
        job = _validated(tables, os.fspath(path), keys)
        job._name, job._text = Path(path).stem, text
        return job

    @classmethod
    def from_dict(cls, mapping: Mapping[str, Any], name: str = "job") -> Job:
        """A job from the tables of a job file as dictionaries; JobError if it is not valid.

        Paths in it are relative to the working directory.
        """
        if not isinstance(mapping, Mapping):
            raise JobError(f"{name}: a job is a dictionary of tables (value {shown(mapping)})")
        job = _validated(mapping, name, ())
        job._name, job._text = name, job.to_toml()
        return job

    def to_toml(self) -> str:
        """The job as a job file that gives an equal job, every default written out."""
        return _lists_in_one_line(tomli_w.dumps(_keys(self)))


def _place_paths(tables: Mapping[str, Any], file: str | os.PathLike[str]) -> None:
    """Put the folder of the job file in front of relative paths: they mean the same wherever the job is run from."""
    initial = tables.get("initial")
    if isinstance(initial, dict) and isinstance(initial.get("run"), str):
        folder = os.path.realpath(Path(file).parent)
        initial["run"] = os.path.join(folder, os.path.expanduser(initial["run"]))  # noqa: PTH111, PTH118


def _keys(job: Job) -> dict[str, Any]:
    """The keys of a job in TOML's types, those without a value left out."""
    tables = plain(job.model_dump(exclude_none=True))
    tables["output"]["checkpoint_every"] = f"{job.output.checkpoint_every!r} s"
    return tables


def _lists_in_one_line(toml: str) -> str:
    """``[64, 64]`` instead of a line for each number; a job has no lists of strings."""
    out, pending = [], ""
    for line in toml.split("\n"):
        if not pending and not line.endswith("["):
            out.append(line)
            continue
        pending += line.strip()
        if pending.endswith(","):
            pending += " "
        elif not pending.endswith("["):
            out.append(pending.replace(", ]", "]"))
            pending = ""
    return "\n".join(out)


def _validated(tables: Mapping[str, Any], name: str, overrides: Iterable[str]) -> Job:
    """Both gates; whatever is wrong becomes one line of a JobError."""
    try:
        raw = plain(tables)
        try:
            return resolve(Job.model_validate(raw))
        except ValidationError as error:
            raise _problem(error, raw) from None
    except KeyProblem as problem:
        raise JobError(f"{name}: {problem.line(overrides)}") from None
    except RecursionError:
        raise JobError(f"{name}: nested too deeply for a job") from None


def _descriptions(
    model: type[BaseModel], path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], str]]:
    """What is allowed under every key of a model and of the tables in it."""
    for name, field in model.model_fields.items():
        key = field.alias or name
        here = (*path, key)
        yield here, field.description or ""
        for table in _tables(field.annotation):
            yield from _descriptions(table, (*here, _state_name(table)) if key == "initial" else here)


def _tables(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models within an annotation, optional or annotated or one of several."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _tables(part)


def _state_name(model: type[BaseModel]) -> str:
    return str(get_args(model.model_fields["state"].annotation)[0])


ALLOWED: dict[tuple[str, ...], str] = dict(_descriptions(Job))

_WRONG = {
    "extra_forbidden": "unknown key",
    "missing": "must be given",
    "literal_error": "unknown value",
    "union_tag_invalid": "unknown state",
    "union_tag_not_found": "must be given",
    "too_short": "wrong number of entries",
    "too_long": "wrong number of entries",
}


def _problem(error: ValidationError, raw: dict[str, Any]) -> KeyProblem:
    """The first thing pydantic found wrong; misspelt keys first, for they explain missing ones."""
    errors = error.errors(include_url=False)
    first = min(errors, key=lambda e: e["type"] != "extra_forbidden")
    # pydantic marks which form of output.times it tried
    steps = pairwise(("", *first["loc"]))
    path = tuple(p for before, p in steps if isinstance(p, str) and not (before == "times" and p in FORMS))
    kind, value, context = first["type"], first["input"], first.get("ctx", {})
    if kind == "union_tag_not_found":
        return KeyProblem("initial.state", "must be given", allowed=_listed(INITIAL_STATES))
    if kind == "union_tag_invalid":
        state = raw["initial"]["state"]
        hint = nearest(state, INITIAL_STATES)
        return KeyProblem("initial.state", "unknown value", state, _listed(INITIAL_STATES), hint)
    key = _key(path) if kind == "missing" else _written_key(path, raw)
    if kind == "extra_forbidden":
        known = _keys_of(path[:-1])
        return KeyProblem(key, "unknown key", allowed=", ".join(known), nearest=_nearest_key(path, known))
    if kind == "missing":
        return KeyProblem(key, "must be given", allowed=ALLOWED.get(path, ""))
    wrong = _WRONG.get(kind, "")
    if kind == "value_error":
        wrong = str(context.get("error", "not allowed"))
    elif not wrong:
        wrong = "wrong type" if kind.endswith("_type") else "out of range"
    hint = nearest(value, re.findall(r'"([^"]*)"', ALLOWED.get(path, ""))) if kind == "literal_error" else ""
    return KeyProblem(key, wrong, value, ALLOWED.get(path, ""), hint)


def _listed(words: Iterable[str]) -> str:
    return " | ".join(f'"{word}"' for word in words)


def _key(path: tuple[str, ...]) -> str:
    """The key as it stands in a file: without pydantic's mark of which initial state it is."""
    if path[0] == "initial" and len(path) > 1:
        path = (path[0], *path[2:])
    return ".".join(p if re.fullmatch(r"[A-Za-z0-9_-]+", p) else f'"{p[:40]}"' for p in path)


def _written_key(path: tuple[str, ...], raw: Any) -> str:
    """The part of a key that is in the file: "specular" for both sides is wrong at x, not at x.lower.kind."""
    parts = _key(path).split(".") if path else []
    written = []
    for part in parts:
        if part in ("lower", "upper") and isinstance(raw, Mapping) and part not in raw:
            continue
        if not isinstance(raw, Mapping) or part not in raw:
            break
        written.append(part)
        raw = raw[part]
    return ".".join(written) or ".".join(parts)


def _keys_of(table: tuple[str, ...]) -> list[str]:
    return [path[-1] for path in ALLOWED if path[:-1] == table]


def _nearest_key(path: tuple[str, ...], known: list[str]) -> str:
    """A key of the same table that looks alike, else the same key where it belongs."""
    found = nearest(path[-1], known)
    if found:
        return found
    elsewhere = [other for other in ALLOWED if other[-1] == path[-1] and other[0] != "initial"]
    return _key(elsewhere[0]) if elsewhere else ""
