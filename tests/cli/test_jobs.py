"""The shipped jobs: each is valid and says how to run it; twins differ only in what they are to compare."""

import math
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from rvm_mpi.job.job import Job

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
JOBS = sorted((ROOT / "jobs").glob("*.toml"))
SCRIPTS = sorted([*(ROOT / "jobs").glob("*.sh"), *(ROOT / "scripts").glob("*.sh")])

PAPERS_SCHEME = {"title", "scaling.kind", "scheme.conservative", "scheme.drift", "fluid.enabled"}
SCALING = {"title", "scaling.kind", "scheme.conservative", "scheme.drift"}
CLASSICAL = {"title", "scaling.kind", "fluid.enabled", "velocity.half_width"}
TWINS = [
    ("test4_clustering", "test4_clustering_kinetic", SCALING),
    ("test4_clustering_e075", "test4_clustering_e075_kinetic", SCALING),
    ("test5_shock", "test5_shock_kinetic", SCALING),
    ("test5_hot_spot", "test5_hot_spot_kinetic", SCALING),
    ("test4_clustering_kinetic", "test4_clustering_kinetic_vz16", {"title", "velocity.points"}),
    ("test5_shock_kinetic", "test5_shock_kinetic_vz16", {"title", "velocity.points"}),
    ("test5_hot_spot_kinetic", "test5_hot_spot_kinetic_vz16", {"title", "velocity.points"}),
    (
        "test4_clustering_kinetic",
        "test4_clustering_pressure_law",
        {"title", "collision.relaxation.temperature_power"},
    ),
    ("test1_coupled", "test1_kinetic", {"title", "scheme.conservative", "scheme.drift"}),
    ("test1_coupled", "test1_macroscopic", {"title", "scaling.kind", "fluid.enabled"}),
    ("test1_coupled", "test1_classical", {"title", "scaling.kind", "velocity.half_width"}),
    ("test2_specular", "test2_macroscopic", PAPERS_SCHEME),
    ("test2_macroscopic", "test2_classical", CLASSICAL | {"velocity.points", "time.end", "output.times"}),
    (
        "test2_specular",
        "test2_periodic",
        {"title", "space.boundary.x.lower.kind", "space.boundary.x.upper.kind", "initial.mode"},
    ),
    ("test3_kinetic", "test3_macroscopic", PAPERS_SCHEME),
    ("test3_macroscopic", "test3_classical", CLASSICAL),
    ("test5_shock", "test5_hot_spot", {"title", "initial.inner", "initial.outer"}),
]


def flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every key of nested tables with its value, keys dotted."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def resolved(name: str) -> dict[str, Any]:
    """The keys of a shipped job with every default written out."""
    return dict(flat(tomllib.loads(Job.from_file(ROOT / "jobs" / f"{name}.toml").to_toml())))


def test_the_jobs_of_the_paper_are_there():
    assert {path.stem for path in JOBS} >= {"demo", *(name for pair in TWINS for name in pair[:2])}


@pytest.mark.parametrize("path", JOBS, ids=lambda path: path.stem)
def test_job_is_valid_and_says_how_to_run_and_plot_it(path):
    job = Job.from_file(path)
    assert job.name == path.stem
    assert job.title
    assert job.output.times[-1] == job.time.end
    opening = path.read_text().split("\n\n")[0].splitlines()
    assert all(line.startswith("#") for line in opening)
    ranks = "mpirun -n 2 " if job.space.dimensions else ""  # without space a job runs on one
    assert f"# Run it:   {ranks}.venv/bin/rvm run jobs/{path.name}" in opening
    assert any(line.startswith("# Plot it:") and line.endswith(f"runs/{path.stem}") for line in opening)


@pytest.mark.parametrize(("one", "other", "differ"), TWINS, ids=[f"{one}-{other}" for one, other, _ in TWINS])
def test_twins_differ_only_in_what_they_compare(one, other, differ):
    first, second = resolved(one), resolved(other)
    assert {key for key in first | second if first.get(key) != second.get(key)} == differ


@pytest.mark.parametrize("name", [one for one, _, differ in TWINS if differ is SCALING])
def test_paper_jobs_have_the_papers_grid_and_scaling(name):
    job = Job.from_file(ROOT / "jobs" / f"{name}.toml")
    assert job.space.cells == (64, 64)
    assert job.velocity.points == (24, 24, 8)
    assert job.velocity.half_width == (7.0, 7.0, 7.0)
    assert (job.scaling.kind, job.scheme.conservative) == ("macroscopic", False)
    assert job.collision.prandtl == pytest.approx(2 / 3, rel=1e-15)


@pytest.mark.parametrize("name", ["test4_clustering", "test4_clustering_e075"])
def test_clustering_jobs_cool_as_the_paper_has_it(name):
    """Quasi-elastic, eps = 1 - e; k_3 = 8 sqrt(pi) b; relaxation of hard spheres, rounded to three digits."""
    collision = Job.from_file(ROOT / "jobs" / f"{name}.toml").collision
    e = collision.restitution
    assert collision.knudsen == pytest.approx(1 - e, rel=1e-12)
    assert collision.cooling == pytest.approx((1 + e) * 8 * math.sqrt(math.pi) / 4 / 3, rel=1e-12)
    hard_spheres = 2 / 3 * 64 / 5 * math.sqrt(math.pi) / 4
    assert collision.relaxation.coefficient == pytest.approx(hard_spheres, abs=5e-3)
    assert (collision.relaxation.density_power, collision.relaxation.temperature_power) == (1, 0.5)


@pytest.mark.parametrize("name", ["test5_shock", "test5_hot_spot"])
def test_shock_jobs_have_the_papers_relaxation_rate(name):
    job = Job.from_file(ROOT / "jobs" / f"{name}.toml")
    relaxation = job.collision.relaxation
    assert relaxation.coefficient == pytest.approx(0.925 * math.pi / 2, rel=1e-15)
    assert (relaxation.density_power, relaxation.temperature_power) == (1, 0)
    assert {side.kind for side in job.space.sides.values()} == {"far-field"}


@pytest.mark.parametrize("test, cells, restitution", [(1, (), 0.8), (2, (25,), 0.9), (3, (100,), 0.9)])
def test_boltzmann_jobs_have_the_papers_grid(test, cells, restitution):
    names = [path.stem for path in JOBS if path.stem.startswith(f"test{test}_")]
    assert len(names) >= 3
    for name in names:
        job = Job.from_file(ROOT / "jobs" / f"{name}.toml")
        classical = job.scaling.kind == "none"
        assert (job.space.cells, job.collision.restitution) == (cells, restitution)
        assert (job.collision.operator, job.collision.exponent, job.collision.cross_section) == ("boltzmann", 1, 1)
        assert job.collision.knudsen == (1.0 if test == 1 else 0.1)
        assert set(job.velocity.points) == {256 if classical and test == 2 else 64}
        assert set(job.velocity.half_width) == {8.0 if classical else {1: 9.0, 2: 10.0, 3: 12.0}[test]}


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_scripts_pass_shellcheck(path):
    command = ["shellcheck", str(path)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stdout


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_scripts_are_executable_and_stop_at_the_first_error(path):
    assert path.stat().st_mode & 0o111
    assert "\nset -euo pipefail\n" in path.read_text()
