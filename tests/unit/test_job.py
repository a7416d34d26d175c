"""The job file: defaults, cross-checks, messages, and that nothing but a Job or one line ever comes out."""

# ruff: noqa: E501  (a table reads better with a case a line)

import copy
import math
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rvm_mpi.job.initial import INITIAL_STATES
from rvm_mpi.job.job import ALLOWED, Job, JobError
from rvm_mpi.job.schema import duration

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TEST_4 = {
    "space": {"cells": [64, 64]},
    "velocity": {"points": [24, 24, 8]},
    "collision": {"operator": "granular-es-bgk", "knudsen": 0.01, "restitution": 0.99},
    "initial": {"state": "random-density"},
    "time": {"end": 30.0},
}


def tables(**changes):
    """Test 4's tables with keys such as collision__knudsen replaced, or removed where None."""
    result = copy.deepcopy(TEST_4)
    for key, value in changes.items():
        *parents, last = key.split("__")
        table = result
        for parent in parents:
            table = table.setdefault(parent, {})
        if value is None:
            table.pop(last, None)
        else:
            table[last] = value
    return result


def job(**changes):
    return Job.from_dict(tables(**changes))


def refused(**changes):
    """The one line with which such a job is refused."""
    with pytest.raises(JobError) as caught:
        job(**changes)
    line = str(caught.value)
    assert line.isprintable()
    assert line.startswith("job: ")
    return line


# --- defaults


def test_defaults_are_those_of_the_documentation():
    made = job()
    assert made.space.lower == (0.0, 0.0)
    assert made.space.upper == (1.0, 1.0)
    assert made.space.spacing == (1 / 64, 1 / 64)
    assert {name: side.kind for name, side in made.space.sides.items()} == dict.fromkeys(
        ("x-lower", "x-upper", "y-lower", "y-upper"), "periodic"
    )
    assert made.velocity.half_width == (7.0, 7.0, 7.0)
    assert (made.scaling.kind, made.scaling.synchronise) == ("kinetic", 0.0)
    assert (made.scheme.drift, made.scheme.conservative) == ("maxwellian", True)
    assert made.fluid.enabled is False
    assert (made.time.cfl, made.time.dt, made.time.max_steps) == (0.5, None, None)
    assert made.output.times == (30.0,)
    assert made.output.checkpoint_every == 600.0
    assert made.output.marginals is False
    assert (made.initial.seed, made.initial.low, made.initial.high) == (0, 0.0, 1.0)
    assert made.collision.prandtl == 2 / 3
    assert made.collision.cross_section == 0.25
    assert made.collision.relaxation.coefficient == pytest.approx(3.78, abs=0.005)
    assert (made.collision.relaxation.density_power, made.collision.relaxation.temperature_power) == (
        1.0,
        0.5,
    )


def test_defaults_of_two_and_one_velocity_dimensions():
    plane = job(velocity__points=[16, 16])
    assert plane.collision.prandtl == 0.5
    assert plane.collision.cross_section == 1.0
    assert plane.collision.relaxation.coefficient == pytest.approx(0.5 * 15 / 8 * math.pi**1.5)
    line = job(space__cells=[8], velocity__points=[16], collision__relaxation={"coefficient": 2.0})
    assert line.collision.prandtl == 1.0
    assert line.collision.relaxation.temperature_power == 0.5
    assert "collision.relaxation: must be given" in refused(space__cells=[8], velocity__points=[16])


def test_cooling_is_the_rate_of_haffs_law():
    k_3, e, knudsen = 2 * math.sqrt(math.pi), 0.99, 0.01
    assert job().collision.cooling == pytest.approx((1 - e**2) * k_3 / 3 / knudsen, rel=1e-14)
    elastic = job(collision={"operator": "es-bgk", "knudsen": 0.1})
    assert elastic.collision.elastic
    assert elastic.collision.cooling == 0.0
    assert job(collision__restitution=1).collision.cooling == 0.0


def test_test_1_is_a_valid_job():
    made = job(
        space__cells=[],
        velocity={"points": [64, 64], "half_width": 9},
        collision={"operator": "boltzmann", "knudsen": 1, "restitution": 0.8},
        initial={"state": "two-gaussians"},
    )
    assert made.space.dimensions == 0
    assert made.space.sides == {}
    assert (made.collision.exponent, made.collision.method, made.collision.prandtl) == (1.0, "direct", None)


def test_diffuse_is_a_maxwell_wall_at_rest():
    made = job(
        space__boundary={
            "x": "diffuse",
            "y": {"lower": "specular", "upper": {"kind": "maxwell", "accommodation": 0.3}},
        }
    )
    wall = made.space.sides["x-upper"]
    assert (wall.kind, wall.accommodation, wall.temperature, wall.velocity) == (
        "maxwell",
        1.0,
        1.0,
        (0.0, 0.0, 0.0),
    )
    assert made.space.sides["y-lower"].kind == "specular"
    assert made.space.sides["y-upper"].accommodation == 0.3


def test_far_field_without_keys_is_left_open():
    far = job(space__boundary={"x": "far-field"}).space.sides["x-lower"]
    assert (far.density, far.temperature, far.velocity) == (None, None, None)
    given_state = {"kind": "far-field", "density": 2, "temperature": 3}
    far = job(space__boundary={"x": given_state}).space.sides["x-lower"]
    assert (far.density, far.temperature, far.velocity) == (2.0, 3.0, (0.0, 0.0, 0.0))


def test_stress_gives_the_temperature():
    made = job(initial={"state": "uniform", "stress": [[1, 0.5, 0], [0.5, 2, 0], [0, 0, 3]]})
    assert made.initial.temperature == 2.0


def test_a_prandtl_number_rounded_down_is_its_bound():
    assert job(collision__prandtl=0.6666).collision.prandtl == 2 / 3
    assert job(collision__prandtl=0.6667).collision.prandtl == 0.6667


# --- round trip

JOBS = {
    "test 4": {},
    "0D": {"space__cells": [], "initial": {"state": "uniform", "stress": [[1, 0, 0], [0, 2, 0], [0, 0, 0.3]]}},
    "walls": {"space__boundary": {"x": "diffuse", "y": {"lower": "outflow", "upper": "vacuum"}}},
    "far field": {"space__boundary": {"x": "far-field", "y": {"kind": "far-field", "density": 1, "temperature": 1}}},
    "elastic": {"collision": {"operator": "es-bgk", "knudsen": 1, "cross_section": 0.1}},
    "free": {"collision": {"operator": "none"}, "scaling__kind": "none", "time__dt": 0.125},
    "disc": {"initial": {"state": "temperature-disc"}, "output__times": [0, 0.1, 30]},
    "wave": {"initial": {"state": "wave", "mode": [1, 2], "velocity_amplitude": [0, 0.1, 0]}},
    "riemann": {
        "initial": {
            "state": "riemann", "direction": "y",
            "left": {"density": 1, "temperature": 1}, "right": {"density": 0.125, "temperature": 0.8},
        }
    },
    "boltzmann": {
        "space__cells": [], "velocity__points": [32, 32, 32], "initial": {"state": "bkw"},
        "collision": {"operator": "boltzmann", "knudsen": 1, "restitution": 1, "exponent": 0, "method": "direct"},
    },
    "strings": {"title": 'a, ]\n[ "b" \u2028 [', "output__checkpoint_every": "1 h 30 min"},
}  # fmt: skip


@pytest.mark.parametrize("changes", JOBS.values(), ids=JOBS)
def test_a_job_written_out_reads_back_equal(changes, tmp_path):
    made = job(**changes)
    file = tmp_path / "again.toml"
    file.write_text(made.to_toml(), encoding="utf-8")
    again = Job.from_file(file)
    assert again == made
    assert hash(again) == hash(made)
    assert again.collision.cooling == made.collision.cooling
    assert again.to_toml() == made.to_toml()
    assert again.name == "again"
    assert again.text == made.to_toml() == made.text


def test_every_default_is_written_out():
    written = tomllib.loads(job().to_toml())
    resolved = {"space.boundary", "space.lower", "time.cfl", "output.times", "collision.relaxation"}
    for path in ALLOWED:
        if len(path) == 2 and path[0] != "initial" and ".".join(path) not in {
            "time.dt", "time.max_steps", "output.every", "collision.exponent", "collision.method", "collision.penalise",
            "collision.coarse",
        }:  # fmt: skip
            assert path[1] in written[path[0]], path
    for key in resolved:
        table, name = key.split(".")
        assert name in written[table]


def test_different_jobs_are_not_equal():
    assert job() == job(collision__knudsen=0.01)
    assert job() != job(collision__knudsen=0.02)
    assert job() != job(title="other")
    assert job() != TEST_4


def test_a_job_does_not_change():
    made = job()
    with pytest.raises(Exception, match="frozen"):
        made.time.end = 2.0


# --- what is refused, and how

REFUSED = [
    # (changes, what the line must contain)
    ({"knudsen": 1}, 'knudsen: unknown key', 'did you mean "collision.knudsen"?'),
    ({"colision": {}}, "colision: unknown key", 'did you mean "collision"?'),
    ({"collision__knudsn": 1.0}, "collision.knudsn: unknown key", 'did you mean "knudsen"?'),
    ({"collision__knudsen": None}, "collision.knudsen: must be given", "allowed a number > 0"),
    ({"collision__knudsen": -1}, "collision.knudsen: out of range", "value -1"),
    ({"collision__knudsen": 0.0}, "collision.knudsen: out of range", "value 0.0"),
    ({"collision__knudsen": True}, "collision.knudsen: wrong type", "value true"),
    ({"collision__knudsen": "0.1"}, "collision.knudsen: wrong type", 'value "0.1"'),
    ({"collision__knudsen": math.nan}, "collision.knudsen: out of range", "value nan"),
    ({"collision__knudsen": math.inf}, "collision.knudsen: out of range", "value inf"),
    ({"collision__knudsen": 5e-324}, "collision.knudsen: too small", ""),
    ({"collision__restitution": 1.1}, "collision.restitution: out of range", "allowed a number from 0 to 1"),
    ({"collision__restitution": -0.1}, "collision.restitution: out of range", "value -0.1"),
    ({"collision__restitution": None}, "collision.restitution: must be given", ""),
    ({"collision__operator": "es-bgk"}, "collision.restitution: not used by", 'did you mean "granular-es-bgk"?'),
    ({"collision__operator": "none"}, "collision.knudsen: not used by", ""),
    ({"collision__operator": "granular"}, "collision.operator: unknown value", 'did you mean "granular-es-bgk"?'),
    ({"collision__operator": 3}, "collision.operator: unknown value", "value 3"),
    ({"collision__exponent": 0.5}, "collision.exponent: not used by", ""),
    ({"collision__prandtl": 0.5}, "collision.prandtl: no Gaussian", "at least 2/3"),
    ({"collision__relaxation": {"coeficient": 1}}, "collision.relaxation.coeficient", 'mean "coefficient"?'),
    ({"collision__relaxation": {}}, "collision.relaxation.coefficient: must be given", ""),
    (
        {"collision": {"operator": "es-bgk", "knudsen": 1, "cross_section": 1, "relaxation": {"coefficient": 1}}},
        "collision.cross_section: not used", "",
    ),
    ({"collision": {"operator": "boltzmann", "knudsen": 1, "restitution": 1, "exponent": 1.5}}, "collision.exponent", ""),
    (
        {"collision": {"operator": "boltzmann", "knudsen": 1, "restitution": 1, "method": "fast"}, "velocity__half_width": 7},
        "collision.method: not in this version", '"direct"',
    ),
    (
        {"collision": {"operator": "boltzmann", "knudsen": 1, "restitution": 1}, "velocity__half_width": [7, 7, 6]},
        "velocity.half_width: the Boltzmann operator needs the same", "one number",
    ),
    ({"collision": {"operator": "boltzmann", "knudsen": 1, "restitution": 1, "prandtl": 1}}, "collision.prandtl: not used", ""),
    ({"space": None}, "space: must be given", ""),
    ({"space__cells": None}, "space.cells: must be given", ""),
    ({"space__cells": [8, 8, 8]}, "space.cells: wrong number of entries", ""),
    ({"space__cells": [2, 8]}, "space.cells: out of range", "from 3 to 65536"),
    ({"space__cells": [8.0, 8]}, "space.cells: wrong type", "value 8.0"),
    ({"space__cells": 8}, "space.cells: wrong type", "value 8"),
    ({"space__cells": [65536, 65536]}, "space.cells: too many cells", ""),
    ({"space__lower": [0.0]}, "space.lower: wrong number of entries", "2, one per space dimension"),
    ({"space__lower": [0, 2]}, "space.upper: not above space.lower", ""),
    ({"space__lower": [1e30, 0], "space__upper": [1.0000000000000002e30, 1]}, "space.upper: cells too narrow", ""),
    ({"velocity__points": [24]}, "space.cells: more space dimensions than velocity", ""),
    ({"velocity__points": []}, "velocity.points: wrong number of entries", ""),
    ({"velocity__points": [24, 24, 2]}, "velocity.points: out of range", ""),
    ({"velocity__points": [1024, 1024, 1024]}, "velocity.points: too many", ""),
    ({"velocity__half_width": [7, 7]}, "velocity.half_width: wrong number of entries", "a list of 3"),
    ({"velocity__half_width": 0}, "velocity.half_width: out of range", ""),
    ({"space__boundary": "periodic"}, "space.boundary: wrong type", ""),
    ({"space__boundary": {"x": "perodic"}}, "space.boundary.x: unknown value", 'did you mean "periodic"?'),
    ({"space__boundary": {"z": "periodic"}}, "space.boundary.z: unknown key", ""),
    ({"space__boundary": {"x": {"lower": "specular"}}}, "space.boundary.x.upper: must be given", ""),
    ({"space__boundary": {"x": {"lower": "specular", "upper": "periodic"}}}, "space.boundary.x: periodic on one side", ""),
    ({"space__boundary": {"x": {"kind": "specular", "temperature": 1}}}, "temperature: not used by", ""),
    ({"space__boundary": {"x": {"kind": "diffuse", "accommodation": 0.5}}}, "accommodation: not used by", ""),
    ({"space__boundary": {"x": {"kind": "maxwell", "accommodation": 2}}}, "accommodation: out of range", ""),
    ({"space__boundary": {"y": {"kind": "maxwell", "velocity": [0, 1, 0]}}}, "cannot move along its normal", "0 along y"),
    ({"space__boundary": {"y": {"kind": "maxwell", "velocity": [1, 0]}}}, "velocity: wrong number of entries", ""),
    ({"space__boundary": {"x": {"kind": "far-field", "density": 1}}}, "temperature: must be given", ""),
    ({"space__cells": [8], "space__boundary": {"y": "specular"}}, "space.boundary.y: space has no y", ""),
    ({"scaling__synchronise": 1}, "scaling.synchronise: not used with", ""),
    ({"scaling__synchronise": "auto"}, 'scaling.synchronise: not used with scaling.kind = "kinetic"', 'value "auto"'),
    (
        {"scaling": {"kind": "macroscopic", "synchronise": "auto"}, "space": {"cells": []}, "initial": {"state": "uniform"}},
        "scaling.synchronise: no cell sets an automatic rate without space",
        "",
    ),
    ({"scaling__synchronise": "fast"}, "scaling.synchronise: wrong type", 'a rate >= 0 or "auto"'),
    ({"scaling__synchronise": True}, "scaling.synchronise: wrong type", ""),
    ({"scaling__synchronise": -1}, "scaling.synchronise: out of range", ""),
    ({"scaling__synchronise": 10**400}, "scaling.synchronise: out of range", ""),
    ({"watch__box_warning": 1.5}, "watch.box_warning: out of range", "1: never"),
    ({"watch__box_stop": 0}, "watch.box_stop: out of range", ""),
    ({"watch__balance": 0}, "watch.balance: out of range", "a number > 0"),
    ({"scaling__kind": "macroscopic", "fluid__enabled": False}, "fluid.enabled", ""),
    ({"scheme__conservative": False}, "scheme.conservative: the kinetic scaling is unstable", ""),
    ({"scheme__conservative": 1}, "scheme.conservative: wrong type", "value 1"),
    ({"collision__penalise": 0}, "collision.penalise: wrong type", "value 0"),
    ({"scheme__drift": "vanleer"}, "scheme.drift: unknown value", 'did you mean "van-leer"?'),
    ({"scheme__drift": "kappa"}, 'scheme.drift: the third order is no more: take "seventh-order"', 'value "kappa"'),
    ({"time__end": 0}, "time.end: out of range", ""),
    ({"time__end": None}, "time.end: must be given", ""),
    ({"time__cfl": 1.5}, "time.cfl: out of range", ""),
    ({"time__cfl": 0.5, "time__dt": 0.1}, "time.dt and time.cfl exclude each other", ""),
    ({"time__dt": 31.0}, "time.dt: longer than the run", ""),
    ({"time__max_steps": 0}, "time.max_steps: out of range", ""),
    ({"time__max_steps": 1.5}, "time.max_steps: wrong type", ""),
    ({"output__times": [0, 40]}, "output.times: after the end", "value 40.0"),
    ({"output__times": [1, 0]}, "output.times: not rising", ""),
    ({"output__times": [0, 1, 1]}, "output.times: not rising", ""),
    ({"output__times": [-1]}, "output.times: out of range", ""),
    ({"output__times": []}, "output.times: wrong number of entries", ""),
    ({"output__times": 3}, "output.times: wrong type", "a list of rising numbers"),
    ({"output__times": [1, "a"]}, "output.times: wrong type", 'value "a"'),
    ({"output__times": {"to": 1}}, "output.times.from: must be given", ""),
    ({"output__times": {"frm": 1, "to": 2, "count": 3}}, "output.times.frm: unknown key", 'did you mean "from"?'),
    ({"output__times": {"from": 1, "to": 40, "count": 3}}, "output.times.to: after the end", "at most time.end = 30.0"),
    ({"output__times": {"from": 2, "to": 1, "count": 3}}, "output.times.from: not below", "value 2.0"),
    ({"output__times": {"from": 0, "to": 1, "count": 3, "spacing": "log"}}, "output.times.from: a logarithm has no 0", ""),
    ({"output__times": {"from": 0, "to": 1, "count": 3, "spacing": "lin"}}, "output.times.spacing: unknown value", "linear"),
    ({"output__times": {"from": 0, "to": 1, "count": 1}}, "output.times.count: out of range", "from 2"),
    ({"output__times": {"from": 0, "to": 1, "count": 3.0}}, "output.times.count: wrong type", ""),
    ({"output__times": {"from": 1, "to": 1.000000000001, "count": 9999}}, "output.times.count: too many", ""),
    ({"output__every": 0}, "output.every: out of range", "instead of times"),
    ({"output__every": "1 s"}, "output.every: wrong type", ""),
    ({"output__every": 31}, "output.every: longer than the run", ""),
    ({"output__every": 1e-9}, "output.every: more than 20000 snapshots", ""),
    ({"output__every": 1, "output__times": [1]}, "output.every: output.times and output.every exclude each other", ""),
    ({"output__checkpoint_every": 600}, "output.checkpoint_every: wrong type", '"10 min"'),
    ({"output__checkpoint_every": "10 minutes"}, "output.checkpoint_every: not a duration", ""),
    ({"output__checkpoint_every": "0 s"}, "output.checkpoint_every: out of range", ""),
    ({"initial__state": "randomdensity"}, "initial.state: unknown value", 'did you mean "random-density"?'),
    ({"initial": {}}, "initial.state: must be given", '"uniform"'),
    ({"initial": None}, "initial: must be given", ""),
    ({"initial": 3}, "initial: wrong type", ""),
    ({"initial__high": 0.0}, "initial.high: out of range", ""),
    ({"initial__low": 1.0}, "initial.low: not below initial.high", ""),
    ({"initial__low": -1}, "initial.low: out of range", ""),
    ({"initial__sed": 1}, "initial.sed: unknown key", 'did you mean "seed"?'),
    ({"initial__seed": 2**63}, "initial.seed: out of range", ""),
    ({"initial__correlation_length": 1e-4}, "initial.correlation_length: out of range", "white noise"),
    ({"space__cells": []}, '"random-density" does not fit a problem without space', ""),
    ({"initial": {"state": "uniform", "density": 0}}, "initial.density: out of range", ""),
    ({"initial": {"state": "uniform", "velocity": [0, 0]}}, "initial.velocity: wrong number", "3, one per velocity"),
    ({"initial": {"state": "uniform", "stress": [[1, 0], [0, 1]]}}, "initial.stress: wrong number", ""),
    ({"initial": {"state": "uniform", "stress": [[1, 2, 0], [2, 1, 0], [0, 0, 1]]}}, "not positive definite", ""),
    ({"initial": {"state": "uniform", "stress": [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]}}, "not symmetric", ""),
    (
        {"initial": {"state": "uniform", "temperature": 2, "stress": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}},
        "initial.temperature: is not the mean", "",
    ),
    ({"initial": {"state": "temperature-disc", "centre": [2, 0.5]}}, "initial.centre: outside the domain", ""),
    ({"initial": {"state": "riemann", "left": {}, "right": {}}}, "initial.left.density: must be given", ""),
    (
        {"space__cells": [8], "initial": {"state": "riemann", "direction": "y",
         "left": {"density": 1, "temperature": 1}, "right": {"density": 1, "temperature": 1}}},
        "initial.direction: space has no such direction", "",
    ),
    ({"initial": {"state": "wave", "mode": [1]}}, "initial.mode: wrong number of entries", "2, one per space"),
    ({"initial": {"state": "wave", "mode": [0.5, 0]}}, "initial.mode: does not fit the domain along x", "whole"),
    ({"initial": {"state": "wave", "mode": [33, 0]}}, "initial.mode: too short a wave", ""),
    ({"initial": {"state": "wave", "density_amplitude": -1}}, "initial.density_amplitude: density would not", ""),
    ({"initial": {"state": "two-gaussians"}}, "does not fit the operator", '"boltzmann"'),
    ({"initial": {"state": "bkw"}}, "does not fit", '"boltzmann"'),
    ({"title": 3}, "title: wrong type", ""),
    ({"title": "a\0b"}, "title: holds the character", ""),
    ({"velocity": 3}, "velocity: wrong type", "a table with points, half_width"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "wrong", "detail"), REFUSED, ids=[str(case[0])[:70] for case in REFUSED])
def test_refused(changes, wrong, detail):
    line = refused(**changes)
    assert wrong in line
    assert detail in line


def test_half_waves_fit_between_walls():
    wave = {"state": "wave", "mode": [0.5, 1.0]}
    assert job(initial=wave, space__boundary={"x": "specular"}).initial.mode == (0.5, 1.0)
    assert "along y" in refused(
        initial={"state": "wave", "mode": [0.5, 0.5]}, space__boundary={"x": "specular"}
    )


def test_numpy_numbers_and_tuples_are_numbers_and_lists():
    made = job(
        space__cells=(np.int64(64), 64),
        collision__knudsen=np.float32(0.5),
        velocity__half_width=np.full(3, 7.0),
    )
    assert made.space.cells == (64, 64)
    assert made.collision.knudsen == 0.5


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("30 s", 30), ("10 min", 600), ("1 h", 3600), ("1.5h", 5400), ("1 h 30 min", 5400), ("2d", 172800)],
)
def test_durations(text, seconds):
    assert duration(text) == seconds


@pytest.mark.parametrize(
    ("end", "output", "times"),
    [
        (0.5, {"every": 0.1}, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]),
        (1.0, {"every": 0.3}, [0.0, 0.3, 0.6, 0.9, 1.0]),
        (1.0, {"every": 1 / 3}, [0.0, 1 / 3, 2 / 3, 1.0]),
        (2e-3, {"every": 1e-3}, [0.0, 1e-3, 2e-3]),
        (7.0, {"every": 7}, [0.0, 7.0]),
        (100.0, {"times": {"from": 0.01, "to": 100, "count": 5, "spacing": "log"}}, [0.01, 0.1, 1.0, 10.0, 100.0]),
        (3.0, {"times": {"from": 0, "to": 1, "count": 3, "spacing": "linear"}}, [0.0, 0.5, 1.0]),
        (3.0, {"times": {"from": 1.0, "to": 3.0, "count": 2}}, [1.0, 3.0]),
    ],
)
def test_output_times_in_few_words(end, output, times):
    made = job(time__end=end, output=output)
    assert list(made.output.times) == times
    assert made.output.every is None
    assert Job.from_dict(tomllib.loads(made.to_toml())) == made


def test_a_film_of_as_many_frames_as_there_may_be_fits_into_a_job_file(tmp_path):
    made = job(time__end=1.0, output={"every": 1 / 19_998.5})
    assert len(made.output.times) == 20_000
    (tmp_path / "job.toml").write_text(made.to_toml())
    assert Job.from_file(tmp_path / "job.toml") == made


# --- files and overrides


def test_of_every_and_times_what_is_set_on_the_command_line_holds(file):
    assert Job.from_file(file, ["output.every=15"]).output.times == (0.0, 15.0, 30.0)
    file.write_text(job(output={"times": [3.0]}).to_toml())
    assert Job.from_file(file, ["output.every=30.0"]).output.times == (0.0, 30.0)
    file.write_text(file.read_text().replace("times = [3.0]", "every = 3.0"))
    assert Job.from_file(file, ["output.times=[2.0]"]).output.times == (2.0,)
    with pytest.raises(JobError, match="exclude each other"):
        Job.from_file(file, ["output.times=[2.0]", "output.every=3"])


def test_the_path_of_a_run_is_relative_to_the_job_file(tmp_path, monkeypatch):
    """On the command line to where one stands."""
    (tmp_path / "jobs").mkdir()
    file = tmp_path / "jobs" / "next.toml"
    text = job(initial={"state": "from-run", "run": "/base"}).to_toml()
    file.write_text(text.replace('"/base"', '"runs/base"'))
    for place in (tmp_path, tmp_path / "jobs", Path("/")):
        monkeypatch.chdir(place)
        for name in (file, os.path.relpath(file)):
            assert Job.from_file(name).initial.run == str(tmp_path / "jobs" / "runs" / "base")
        assert Job.from_file(file, ['initial.run="base"']).initial.run == str(place / "base")
    file.write_text(text)
    assert Job.from_file(file).initial.run == "/base"
    file.write_text(text.replace('"/base"', '"~/base"'))
    assert Job.from_file(file).initial.run == str(Path.home() / "base")


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "job.toml"
    path.write_text(job().to_toml())
    return path


@pytest.mark.parametrize(
    ("override", "read", "value"),
    [
        ("collision.restitution=0.75", lambda j: j.collision.restitution, 0.75),
        (" time.end = 31 ", lambda j: j.time.end, 31.0),
        ('title="a = b"', lambda j: j.title, "a = b"),
        ("space.cells=[32, 16]", lambda j: j.space.cells, (32, 16)),
        ('initial={state="uniform"}', lambda j: j.initial.state, "uniform"),
        ("fluid.enabled=false", lambda j: j.fluid.enabled, False),
        ("time.max_steps=7", lambda j: j.time.max_steps, 7),
    ],
)
def test_override(file, override, read, value):
    assert read(Job.from_file(file, [override])) == value


@pytest.mark.parametrize(
    ("override", "wrong"),
    [
        ("scaling.kind=none", "text needs quotes: --set 'scaling.kind=\"none\"'"),
        ("time.end", "must be KEY=VALUE"),
        ("=3", "must be KEY=VALUE"),
        ("a b=3", "must be KEY=VALUE"),
        ("time.end=", "the value is not TOML"),
        ("time.end=1\ntime.cfl=2", "the value is not TOML"),
        ("title.text=3", "title is not a table"),
        ("collision.knudsn=3", 'did you mean "knudsen"? [from --set]'),
    ],
)
def test_bad_override(file, override, wrong):
    with pytest.raises(JobError) as caught:
        Job.from_file(file, [override])
    assert wrong in str(caught.value)
    assert str(caught.value).isprintable()


def unreadable(tmp_path):
    yield "missing", tmp_path / "missing.toml", "no such file"
    (tmp_path / "demo.toml").write_text("x = 1")
    yield "slip", tmp_path / "dmo.toml", 'did you mean "demo.toml"?'
    yield "directory", tmp_path, "is a directory"
    yield "device", "/dev/null", "not a regular file"
    (tmp_path / "broken.toml").write_text("[space]\ncells = [64, \n[velocity]\n")
    yield "broken", tmp_path / "broken.toml", "not valid TOML"
    (tmp_path / "twice.toml").write_text("[time]\nend = 1\nend = 2\n")
    yield "twice", tmp_path / "twice.toml", "line 3"
    (tmp_path / "binary.toml").write_bytes(b"\x89HDF\r\n\x1a\n\xff\xfe")
    yield "binary", tmp_path / "binary.toml", "not UTF-8"
    (tmp_path / "large.toml").write_bytes(b"#" * 2_000_000)
    yield "large", tmp_path / "large.toml", "too large"
    (tmp_path / "deep.toml").write_text("a = " + "[" * 5000 + "]" * 5000)
    yield "deep", tmp_path / "deep.toml", "not valid TOML"
    (tmp_path / "digits.toml").write_text("a = " + "9" * 5000)
    yield "digits", tmp_path / "digits.toml", "digits.toml"
    (tmp_path / "empty.toml").write_text("")
    yield "empty", tmp_path / "empty.toml", "space: must be given"
    yield "null byte", "a\0b.toml", "cannot be read"
    (tmp_path / "two\nlines.toml").write_text("")
    yield "two lines", tmp_path / "two\nlines.toml", "two\\nlines.toml: space"


def test_files_that_cannot_be_read(tmp_path):
    for what, path, wrong in unreadable(tmp_path):
        with pytest.raises(JobError) as caught:
            Job.from_file(path)
        assert wrong in str(caught.value), what
        assert str(caught.value).isprintable(), what


# --- anything at all

scalars = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=20), st.sampled_from(["periodic", "10 min"]),
    st.integers(min_value=10**300, max_value=10**400), st.dates(), st.binary(max_size=4),
)  # fmt: skip
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=12), inner, max_size=4),
    max_leaves=8,
)
paths = st.sampled_from([path for path in ALLOWED if path[0] != "initial" or len(path) == 1])
state_keys = st.sampled_from(
    [(name, path[2:]) for name in INITIAL_STATES for path in ALLOWED if path[1:2] == (name,)]
)


def outcome(mapping):
    """A job that reads back equal, or one line."""
    try:
        made = Job.from_dict(mapping)
    except JobError as error:
        assert str(error).isprintable()
        assert len(str(error)) < 1500
        return
    assert Job.from_dict(tomllib.loads(made.to_toml())) == made
    assert math.isfinite(made.collision.cooling)


@settings(deadline=None, max_examples=300)
@given(changes=st.dictionaries(paths, values, min_size=1, max_size=3))
def test_junk_anywhere_in_a_job(changes):
    mapping = copy.deepcopy(TEST_4)
    for path, value in changes.items():
        table = mapping
        for part in path[:-1]:
            if not isinstance(table.get(part), dict):
                table[part] = {}
            table = table[part]
        table[path[-1]] = value
    outcome(mapping)


@settings(deadline=None, max_examples=300)
@given(state=st.sampled_from(sorted(INITIAL_STATES)), keys=st.dictionaries(state_keys, values, max_size=4))
def test_junk_in_an_initial_state(state, keys):
    mapping = copy.deepcopy(TEST_4)
    mapping["initial"] = {"state": state}
    for (owner, path), value in keys.items():
        if owner == state and len(path) == 1:
            mapping["initial"][path[0]] = value
    outcome(mapping)


@settings(deadline=None, max_examples=100)
@given(mapping=st.dictionaries(st.text(max_size=12), values, max_size=4) | values)
@example(mapping={"(": 1})
@example(mapping={"(list)": 1})
def test_junk_instead_of_a_job(mapping):
    outcome(mapping)


@settings(deadline=None, max_examples=200)
@given(
    override=st.text(max_size=40)
    | st.tuples(paths, st.text(max_size=20)).map(lambda p: ".".join(p[0]) + "=" + p[1])
)
def test_junk_as_an_override(tmp_path_factory, override):
    path = tmp_path_factory.getbasetemp() / "override.toml"
    if not path.exists():
        path.write_text(job().to_toml())
    try:
        made = Job.from_file(path, [override])
    except JobError as error:
        assert str(error).isprintable()
    else:
        assert isinstance(made, Job)


@settings(deadline=None, max_examples=100)
@given(
    knudsen=st.floats(1e-6, 1e3),
    restitution=st.floats(0, 1),
    points=st.lists(st.integers(4, 40), min_size=2, max_size=3),
    cells=st.lists(st.integers(3, 200), min_size=1, max_size=2),
    seed=st.integers(0, 2**63 - 1),
    end=st.floats(1e-3, 1e3),
)
def test_every_sensible_job_is_valid_and_reads_back(knudsen, restitution, points, cells, seed, end):
    made = Job.from_dict(
        {
            "space": {"cells": cells},
            "velocity": {"points": points},
            "collision": {"operator": "granular-es-bgk", "knudsen": knudsen, "restitution": restitution},
            "initial": {"state": "random-density", "seed": seed},
            "time": {"end": end},
        }
    )
    assert Job.from_dict(tomllib.loads(made.to_toml())) == made
