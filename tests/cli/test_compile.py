"""`rvm compile`: later runs find all they need, and the bits do not depend on what was compiled, when, or for whom."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

#: two steps of a small gas in the plane and of one between walls, and a hash of all that they leave
STEPS = """
import hashlib
from rvm_mpi import Job, Simulation
from rvm_mpi.commands.bench import _job
walls = {
    "space": {"cells": [5], "boundary": {"x": "diffuse"}}, "velocity": {"points": [16], "half_width": 9.0},
    "collision": {"operator": "boltzmann", "knudsen": 0.1, "restitution": 0.9, "penalise": True},
    "scheme": {"drift": "seventh-order-positive"}, "time": {"end": 1.0}, "initial": {"state": "random-density"},
}
digest = hashlib.sha256()
for job in (_job((4, 4), (10, 9, 8)), Job.from_dict(walls)):
    sim = Simulation(job)
    for _ in range(2):
        sim.advance()
    for array in (sim.kinetic.g, sim.kinetic.now.sums, sim.kinetic.now.carried):
        digest.update(array.tobytes())
print(digest.hexdigest())
"""
#: a step of every shipped job on a few cells and velocities
SHIPPED = """
import pathlib
from rvm_mpi import Job, Simulation
done = 0
for path in sorted(pathlib.Path("jobs").glob("*.toml")):
    job = Job.from_file(path)
    tables = [f"space.cells={[4] * len(job.space.cells)}", f"velocity.points={[16] * len(job.velocity.points)}"]
    if job.initial.state == "from-run":
        continue
    if job.collision.operator == "boltzmann" and len(job.velocity.points) == 3:
        tables[1] = "velocity.points=[8, 8, 8]"
    sim = Simulation(Job.from_file(path, tables))
    sim.advance()
    sim.snapshot(), sim.walls()
    done += 1
print(done)
"""


def run(command, cache, **environment):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), **environment}
    done = subprocess.run(
        [sys.executable, *command], env=environment, cwd=ROOT, capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A cache that `rvm compile` has filled for a processor with AVX2 alone, what it said."""
    cache, environment = tmp_path_factory.mktemp("cache"), {"NUMBA_CPU_NAME": "haswell"}
    done = run(["-m", "rvm_mpi", "compile"], cache, **environment)
    return cache, environment, done


def codes(cache):
    return {path.name for path in cache.rglob("*.nbc")}


def test_it_says_what_it_does(compiled):
    cache, environment, done = compiled
    lines = done.stderr.splitlines()
    assert [line.split(":")[0] for line in lines] == [f"compiling kernels, {n} of 3" for n in (1, 2, 3)]
    assert done.stdout.startswith("the kernels are compiled, in ")
    again = run(["-m", "rvm_mpi", "compile"], cache, **environment)
    assert not again.stderr
    assert again.stdout == done.stdout


def test_the_shipped_jobs_find_all_they_need(compiled):
    cache, environment, _ = compiled
    before = codes(cache)
    assert before
    assert int(run(["-c", SHIPPED], cache, **environment).stdout) > 20
    assert codes(cache) == before


def test_the_same_bits_with_avx2_as_with_what_this_processor_has(compiled, tmp_path):
    """From a full cache of another processor's, and from the usual one of this."""
    cache, environment, _ = compiled
    other = run(["-c", STEPS], cache, **environment).stdout
    usual = os.environ.get("NUMBA_CACHE_DIR", "")
    assert run(["-c", STEPS], usual).stdout == other
