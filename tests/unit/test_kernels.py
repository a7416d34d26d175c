"""Kernels: the same bits however they came to be compiled, never stale, and a cache that cannot stop a run."""

import errno
import fcntl
import operator
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from llvmlite.binding import get_host_cpu_features
from numba import njit
from numba.core import types
from numba.core.registry import cpu_target

from rvm_mpi.compiling import declare as kernels
from rvm_mpi.compiling.declare import kernel, part

ROOT = Path(__file__).resolve().parents[2]

#: sums over the nodes of one cell, and whether their kernel came from the cache
SUMS = """
import numpy as np
from rvm_mpi.kinetic import moments
from rvm_mpi.step.sweep import Space, kernel_grid
from rvm_mpi.grid.velocity import VelocityGrid
grid = VelocityGrid.create((5, 4, 4), (7.0, 6.0, 5.0))
g = np.random.default_rng(1).uniform(size=(1, 1, grid.block))
sums = moments.sums_about(g, Space(0, 1, 1, 0, 0, 0.0, 0.0), kernel_grid(grid), np.zeros((1, 1, 3)))
print(*map(float.hex, sums.ravel()), sum(moments._sums_about.stats.cache_hits.values()))
"""
#: two steps of a small gas in the plane, and a hash of all that they leave
STEPS = """
import hashlib
from rvm_mpi.commands.bench import _job
from rvm_mpi.simulation import Simulation
sim = Simulation(_job((4, 4), (10, 9, 8)))
for _ in range(2):
    sim.advance()
digest = hashlib.sha256()
for array in (sim.kinetic.g, sim.kinetic.now.sums, sim.kinetic.now.carried, sim.fluid.state):
    digest.update(array.tobytes())
print(digest.hexdigest())
"""
#: kernels and parts that the steps have too, compiled by themselves and for other arguments before
OTHERS = """
import numpy as np
from rvm_mpi.kinetic import conservation
from rvm_mpi.fluid import cells
assert not conservation.solve(np.zeros((2, 2)) - np.eye(2), np.zeros(2), 2)
cells.cool(np.ones((1, 1, 3)), 1.0, 1.0, 0.1)
assert conservation.relative_mismatch(np.ones(10), 1.0, 1.0, 3.0) == 1.0
"""


def start(program, cache, package=ROOT, **environment):
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(cache),
        "PYTHONPATH": str(package),
        "PYTHONDONTWRITEBYTECODE": "1",
        **environment,
    }
    command = [sys.executable, "-c", program]
    return subprocess.Popen(command, env=environment, cwd=package, stdout=subprocess.PIPE, text=True)


def said(process):
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    return out.split()


def run(program, cache, package=ROOT, **environment):
    return said(start(program, cache, package, **environment))


def test_the_same_bits_from_any_cache_in_any_order(tmp_path):
    first = run(STEPS, tmp_path / "a")
    assert run(STEPS, tmp_path / "a") == first
    assert run(OTHERS + SUMS + STEPS, tmp_path / "b")[-1:] == first
    assert run(STEPS + SUMS, tmp_path / "b")[:1] == first


def test_a_change_in_what_a_kernel_calls_is_seen(tmp_path):
    package = tmp_path / "changed"
    shutil.copytree(ROOT / "rvm_mpi", package / "rvm_mpi", ignore=shutil.ignore_patterns("__pycache__"))
    *before, hits = run(SUMS, tmp_path / "cache", package)
    assert hits == "0"
    assert run(SUMS, tmp_path / "cache", package) == [*before, "1"]
    source = package / "rvm_mpi" / "kinetic" / "conservation.py"
    times = source.stat()
    text = source.read_text()
    assert text.count(" xx + f * a2,") == 1
    source.write_text(text.replace(" xx + f * a2,", " xx + f * a1,"))
    os.utime(source, ns=(times.st_atime_ns, times.st_mtime_ns))  # neither its time nor its size tells
    *after, hits = run(SUMS, tmp_path / "cache", package)
    assert hits == "0"
    assert after[4] == before[1]
    source.write_text(text)
    assert run(SUMS, tmp_path / "cache", package) == [*before, "1"]


def test_another_processor_has_kernels_of_its_own(tmp_path):
    *here, _ = run(SUMS, tmp_path)
    *there, hits = run(SUMS, tmp_path, NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="")
    assert hits == "0"
    np.testing.assert_allclose([float.fromhex(x) for x in there], [float.fromhex(x) for x in here], rtol=1e-14)
    assert len(list((tmp_path / "kernels").iterdir())) == 2
    assert run(SUMS, tmp_path) == [*here, "1"]


def test_of_those_that_start_together_one_compiles(tmp_path):
    all_said = [said(process) for process in [start(SUMS, tmp_path) for _ in range(4)]]
    assert sorted(words[-1] for words in all_said) == ["0", "1", "1", "1"]
    assert len({tuple(words[:-1]) for words in all_said}) == 1


def test_one_that_dies_over_it_leaves_the_others_to_compile(tmp_path):
    *wanted, _ = run(SUMS, tmp_path)
    (code,) = tmp_path.glob("kernels/*/*._sums_about-*.code")
    code.unlink()
    holding = "import fcntl, sys, time; f = open(sys.argv[1]); fcntl.flock(f, fcntl.LOCK_EX); print(); time.sleep(60)"
    command = [sys.executable, "-uc", holding, code.with_suffix(".lock")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as holder:
        holder.stdout.readline()
        waiting = start(SUMS, tmp_path)
        time.sleep(3.0)
        assert waiting.poll() is None
        assert not code.exists()
        holder.kill()
    assert said(waiting) == [*wanted, "0"]


@pytest.mark.parametrize("place", ["a file", "nothing that can be made"])
def test_no_place_for_a_cache(tmp_path, place):
    (tmp_path / "file").touch()
    cache = tmp_path / "file" if place == "a file" else Path("/proc/none")
    assert run(SUMS, cache)[-1] == "0"
    assert run(SUMS, cache) == run(SUMS, tmp_path / "good")


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A kernel of this file that is kept in an empty directory, and how to have it as another process would."""
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", str(tmp_path))
    kernels.kept_in.cache_clear()

    def anew():
        compiled = kernel(double)
        compiled._cache = kernels._Kept(double)
        return compiled

    yield anew
    kernels.kept_in.cache_clear()


def double(x):
    return 2.0 * x


def hits(compiled):
    return sum(compiled.stats.cache_hits.values())


def only_file(suffix):
    (found,) = kernels.kept_in().glob(f"*{suffix}")
    return found


def test_a_damaged_file_is_not_trusted(kept):
    assert kept()(1.0) == 2.0
    path = only_file(".code")
    whole = path.read_bytes()
    for damaged in (b"", whole[:100], whole[:-1], whole[:-1] + bytes([whole[-1] ^ 1])):
        path.write_bytes(damaged)
        compiled = kept()
        assert compiled(3.0) == 6.0
        assert hits(compiled) == 0
        assert path.read_bytes()[32:]
        again = kept()
        assert again(3.0) == 6.0
        assert hits(again) == 1


def test_a_full_disk(kept, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(kernels, "write_whole", full)
    compiled = kept()
    assert compiled(1.0) == 2.0
    assert hits(compiled) == 0
    assert not list(kernels.kept_in().glob("*.code"))
    with only_file(".lock").open() as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # nobody has to wait for one that could not write


def test_a_lock_that_is_never_given_back(kept, monkeypatch):
    monkeypatch.setattr(kernels, "PATIENCE", 0.1)
    compiled = kept()
    path = compiled._cache._path((kernels.types.float64,))
    with path.with_suffix(".lock").open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert compiled(1.0) == 2.0
    assert path.exists()


def test_the_oldest_directories_go(kept):
    directory = kernels.kept_in().parent
    for age in range(kernels.KEPT + 3):
        old = directory / f"old{age}"
        old.mkdir()
        (old / "some.code").touch()
        os.utime(old, (1e9 - age, 1e9 - age))
    kernels.kept_in().rmdir()
    kernels.kept_in.cache_clear()
    assert kernels.kept_in().is_dir()
    assert {one.name for one in directory.iterdir()} == {kernels.kept_in().name} | {
        f"old{age}" for age in range(kernels.KEPT - 1)
    }


@part
def tripled(x):
    """x three times."""
    return 3.0 * x


@part(fused=False)
def times(a, b):
    return a * b


@kernel
def combined(a, b):
    return tripled(a) + times(a, b)


def test_parts_within_kernels_and_by_themselves():
    assert combined(2.0, 5.0) == 16.0
    assert tripled(2.0) == 6.0
    assert times(2.0, 3) == 6.0
    assert tripled.__name__ == "tripled"
    assert tripled.__doc__ == "x three times."


@part
def power(base, exponent):
    result = base
    for _ in range(1, exponent):
        result *= base
    return result


@kernel
def powers(x):
    return power(x, 2) + power(x, 3)


def test_a_part_is_compiled_once_for_all_literals():
    assert powers(2.0) == 12.0
    assert len(power._part.overloads) == 1


@kernel
def touch(line, plane, numbers, out):
    """Elements from either end, read and written, of arrays of one and two axes."""
    out[0], out[1] = line[2], line[-1]
    out[2], out[3], out[4] = plane[1, 2], plane[-1, -2], plane[1][0]
    out[-1] = numbers[-2] + numbers[0]
    line[1], line[-2] = 7, line[0]
    plane[0, -1] = numbers[1]
    numbers[-1] = 5


@pytest.mark.parametrize("order", ["C", "F", "strided"])
def test_elements_of_arrays(order):
    def arrays():
        line, plane, numbers = np.arange(4.0), 10.0 + np.arange(6.0).reshape(2, 3), np.arange(20, 23)
        if order == "strided":
            return np.repeat(line, 2)[::2], np.repeat(plane, 2, axis=1)[:, ::2], np.repeat(numbers, 2)[::2], np.ones(6)
        return line, np.asarray(plane, order=order), numbers, np.ones(6)

    found, wanted = arrays(), arrays()
    touch(*found)
    touch.py_func(*wanted)
    for one, other in zip(found, wanted):
        assert np.array_equal(one, other)


def test_other_people_s_functions_keep_numba_s_own_rules():
    assert combined(2.0, 5.0) == 16.0
    own = cpu_target.typing_context.resolve_value_type(operator.add)
    assert type(own) is types.Function
    assert njit(lambda a, b: a + b)(1, np.ones(2)).tolist() == [2.0, 2.0]


def test_products_are_fused_only_where_they_may_be():
    def difference(a, b, c):
        return a * b - c

    a, b = 1.0 + 2.0**-30, 1.0 - 2.0**-30
    assert kernel(fused=False)(difference)(a, b, a * b) == 0.0
    has_them = bool(get_host_cpu_features().get("fma"))
    assert kernel(difference)(a, b, a * b) == (-(2.0**-60) if has_them else 0.0)
