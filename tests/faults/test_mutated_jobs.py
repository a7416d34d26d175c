"""Bad job files by the hundred: a good job with something changed in it at random.

Whatever was changed, `rvm check` ends in time with 0, or with 2 and one line; where what was changed is wrong by the
rules of the job file, restated here on their own, it is 2 and the line names the key. What is accepted can be run.
"""

import copy
import datetime
import math
import time

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rvm_mpi.commands.main import main
from rvm_mpi.job.text import parse_toml

IN_TIME = 20.0
"""Seconds for one job on a busy machine."""

BASE = {
    "space": {"cells": [6, 5], "lower": [0.0, 0.0], "upper": [1.0, 1.0]},
    "velocity": {"points": [12, 10], "half_width": 7.0},
    "time": {"end": 0.1, "cfl": 0.4},
    "output": {"times": [0.0, 0.05, 0.1]},
}
WALL = {"kind": "maxwell", "accommodation": 0.5, "temperature": 1.2, "velocity": [0.0, 0.1]}
GOOD = {
    "granular": {
        **BASE,
        "space": {**BASE["space"], "boundary": {"x": {"lower": WALL, "upper": "far-field"}, "y": "specular"}},
        "scaling": {"kind": "macroscopic", "synchronise": 1.0},
        "collision": {
            "operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.9, "prandtl": 0.7,
            "relaxation": {"coefficient": 3.0, "density_power": 1, "temperature_power": 0.5},
        },
        "scheme": {"drift": "van-leer", "conservative": True},
        "fluid": {"enabled": True},
        "initial": {"state": "random-density", "seed": 3, "low": 0.5, "high": 1.0, "temperature": 1.0},
    },
    "elastic": {
        **BASE,
        "space": {"cells": [7], "boundary": {"x": "periodic"}},
        "collision": {"operator": "es-bgk", "knudsen": 0.1},
        "initial": {"state": "wave", "density": 1.0, "density_amplitude": 0.2, "mode": [1]},
    },
    "boltzmann": {
        **BASE,
        "space": {"cells": []},
        "velocity": {"points": [12, 12], "half_width": 8.0},
        "collision": {"operator": "boltzmann", "knudsen": 1.0, "restitution": 0.9, "exponent": 1.0, "penalise": False,
                      "coarse": True},
        "initial": {"state": "two-gaussians", "sigma": 0.7},
    },
}  # fmt: skip

# the job file's rules, as its users have them
NUMBERS = {
    "collision.knudsen": lambda v: v > 0,
    "collision.restitution": lambda v: 0 <= v <= 1,
    "collision.exponent": lambda v: 0 <= v <= 1,
    "collision.relaxation.coefficient": lambda v: v > 0,
    "scaling.synchronise": lambda v: v >= 0,
    "time.end": lambda v: v > 0,
    "time.cfl": lambda v: v > 0,
    "initial.temperature": lambda v: v > 0,
    "initial.density": lambda v: v > 0,
    "initial.sigma": lambda v: v > 0,
    "velocity.half_width": lambda v: v > 0,
    "space.boundary.x.lower.accommodation": lambda v: 0 <= v <= 1,
    "space.boundary.x.lower.temperature": lambda v: v > 0,
}
WORDS = {
    "scaling.kind": {"none", "macroscopic", "kinetic"},
    "collision.operator": {"none", "es-bgk", "granular-es-bgk", "boltzmann"},
    "scheme.drift": {"van-leer", "maxwellian", "seventh-order", "seventh-order-positive"},
}
SWITCHES = ("scheme.conservative", "fluid.enabled", "collision.penalise")


def certainly_wrong(key, value):
    """Whether a value breaks the rule of its key, whatever the rest of the job is."""
    if key in NUMBERS:
        if key == "velocity.half_width" and isinstance(value, list):
            return not all(isinstance(v, (int, float)) for v in value)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return True
        return not math.isfinite(value) or not NUMBERS[key](value)
    if key in WORDS:
        return not isinstance(value, str) or value not in WORDS[key]
    return key in SWITCHES and not isinstance(value, bool)


def paths(table, prefix=()):
    """Keys of nested tables as tuples, tables too."""
    for name, value in table.items():
        yield (*prefix, name)
        if isinstance(value, dict):
            yield from paths(value, (*prefix, name))


def table_of(job, path):
    for name in path[:-1]:
        job = job[name]
    return job


ODD_NUMBERS = [0, -1, 1, 2, 3, 10**6, 10**18, -(2**63), 10**30, 0.0, -0.0, 1e-320, 1e-30, 1e30, 1e308, -1e308,
               math.nan, math.inf, -math.inf, 0.5, 0.999999]  # fmt: skip
SCALARS = st.one_of(
    st.sampled_from(ODD_NUMBERS),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(),
    st.booleans(),
    st.text(max_size=8),
    st.sampled_from(["none", "kinetic", "auto", "vacuum", "bkw", "wave", "from-run", "maxwell", "direct", "10 min"]),
    st.just(datetime.date(2024, 2, 29)),
)
VALUES = st.one_of(
    SCALARS,
    st.lists(SCALARS, max_size=4),
    st.lists(st.lists(SCALARS, max_size=3), max_size=3),
    st.dictionaries(st.sampled_from(["kind", "lower", "x", "", "é"]), SCALARS, max_size=2),
)
NAMES = st.one_of(st.text(min_size=1, max_size=6), st.sampled_from(["cell", "knudsn", "dt", "penalise", "method"]))


@st.composite
def mutated(draw):
    """Text of a job, and (key, value) of a change that is wrong for certain, or None."""
    job = copy.deepcopy(GOOD[draw(st.sampled_from(sorted(GOOD)))])
    wrong = None
    for _ in range(draw(st.integers(1, 2))):
        path = draw(st.sampled_from(sorted(paths(job))))
        table, key = table_of(job, path), ".".join(path)
        what = draw(st.sampled_from(["replace", "replace", "replace", "remove", "add"]))
        if what == "remove":
            del table[path[-1]]
        elif what == "add":
            table[draw(NAMES)] = draw(VALUES)
        else:
            table[path[-1]] = value = draw(VALUES)
            if certainly_wrong(key, value):
                wrong = (key, value)
    text = tomli_w.dumps(job)
    if draw(st.integers(0, 4)) == 0:  # a slip of the hand in the text
        place = draw(st.integers(0, len(text) - 1))
        text = text[:place] + draw(st.text(max_size=2)) + text[place + draw(st.integers(0, 3)) :]
        wrong = None
    elif wrong:  # a second change may have taken the first away
        left = job
        for name in wrong[0].split("."):
            left = left.get(name) if isinstance(left, dict) else None
        wrong = wrong if left is wrong[1] else None
    return text, wrong


def small_enough(text):
    """Whether one step of an accepted job is quick."""
    job = parse_toml(text, "job")
    return math.prod(job["space"]["cells"]) * math.prod(job["velocity"]["points"]) <= 20_000


def try_job(directory, capsys, text, wrong, step=False):
    path = directory / "job.toml"
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    began = time.monotonic()
    status = main(["check", str(path)])
    seconds = time.monotonic() - began
    said = capsys.readouterr()
    assert seconds < IN_TIME, text
    assert status in (0, 2), said.err + text
    if status == 2:
        assert said.out == ""
        assert said.err.startswith("rvm: ") and said.err.count("\n") == 1, said.err
    if wrong:
        assert status == 2, f"{wrong} was accepted\n{text}"
    elif status == 0 and step and small_enough(text):
        output = directory / f"run-{time.monotonic_ns()}"
        status = main(["run", str(path), "--output", str(output), "--set", "time.max_steps=1"])
        said = capsys.readouterr()
        assert status in (0, 2, 3), said.err + text
        assert status == 0 or said.err.splitlines()[-1].startswith("rvm: "), said.err
        assert "Traceback" not in said.err
        return f"accepted, and a step ended with {status}"
    return "refused" if status == 2 else "accepted"


RULES = {"deadline": None, "derandomize": True, "database": None,
         "suppress_health_check": [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]}  # fmt: skip


@pytest.mark.timeout(300)
def test_no_change_to_a_job_gives_anything_but_a_line(tmp_path, capsys, tally):
    @settings(max_examples=200, **RULES)
    @given(mutated())
    def each(job):
        tally["mutated jobs " + try_job(tmp_path, capsys, *job)] += 1

    each()


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_what_is_accepted_can_be_run(tmp_path, capsys, tally):
    @settings(max_examples=3000, **RULES)
    @given(mutated())
    def each(job):
        tally["mutated jobs " + try_job(tmp_path, capsys, *job, step=True)] += 1

    each()


def test_the_good_jobs_are_good(tmp_path, capsys):
    for name, job in GOOD.items():
        assert try_job(tmp_path, capsys, tomli_w.dumps(job), None) == "accepted", name
