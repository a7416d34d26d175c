"""Kernels: the same bits however they came to be compiled, never stale, and a cache that cannot stop a run."""

import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rvm_mpi.compiling import declare as kernels
from rvm_mpi.compiling.declare import kernel, part
from rvm_mpi.compiling.simd import fma

ROOT = Path(__file__).resolve().parents[2]

#: sums over the nodes of one cell, and whether their kernel came from the cache
SUMS = """
import numpy as np
from rvm_mpi.kinetic import moments
from rvm_mpi.step.data import Space, kernel_grid
from rvm_mpi.grid.velocity import VelocityGrid
grid = VelocityGrid.create((5, 4, 4), (7.0, 6.0, 5.0))
g = np.random.default_rng(1).uniform(size=(1, 1, grid.block))
sums = moments.sums_about(g, Space(0, 1, 1, 0, 0, 0.0, 0.0), kernel_grid(grid), np.zeros((1, 1, 3)))
print(*map(float.hex, sums.ravel()), sum(moments._sums_about._compiled.stats.cache_hits.values()))
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


def test_a_change_in_what_a_kernel_calls_is_seen(tmp_path):
    package = tmp_path / "changed"
    shutil.copytree(ROOT / "rvm_mpi", package / "rvm_mpi", ignore=shutil.ignore_patterns("__pycache__"))
    *before, hits = run(SUMS, tmp_path / "cache", package)
    assert hits == "0"
    assert run(SUMS, tmp_path / "cache", package) == [*before, "1"]
    source = package / "rvm_mpi" / "kinetic" / "conservation.py"
    times = source.stat()
    text = source.read_text()
    assert text.count("fma(f, a2, xx),") == 1
    source.write_text(text.replace("fma(f, a2, xx),", "fma(f, a1, xx),"))
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
    assert there == here
    assert len(list((tmp_path / "kernels").iterdir())) == 2
    assert run(SUMS, tmp_path) == [*here, "1"]


@pytest.mark.parametrize("place", ["a file", "nothing that can be made"])
def test_no_place_for_a_cache(tmp_path, place):
    (tmp_path / "file").touch()
    cache = tmp_path / "file" if place == "a file" else Path("/proc/none")
    assert run(SUMS, cache)[-1] == "0"
    assert run(SUMS, cache) == run(SUMS, tmp_path / "good")


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """An empty directory for kernels."""
    monkeypatch.setattr(kernels.numba.config, "CACHE_DIR", str(tmp_path))
    kernels.kept_in.cache_clear()
    yield tmp_path
    kernels.kept_in.cache_clear()


def double(x):
    return 2.0 * x


double.__module__ = "rvm_mpi.double"  # as the package's own, which alone are kept


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("content", [b"", b"\0" * 1000, b"short"])
def test_a_damaged_file_does_not_stop_a_run(kept, suffix, content):
    assert kernel(double)(1.0) == 2.0
    (path,) = kept.rglob(f"*.{suffix}")
    path.write_bytes(content)
    assert kernel(double)(3.0) == 6.0


def test_a_full_disk(kept, monkeypatch):
    compiled = kernel(double)

    def full(*_, **__):
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr("os.replace", full)  # how files are put in place
    assert compiled(1.0) == 2.0
    assert not list(kept.rglob("*.nbc"))


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


def test_other_people_s_functions_keep_numba_s_own_place(kept):
    assert kernel(double)(1.0) == 2.0
    assert str(kept) == kernels.numba.config.CACHE_DIR


@part
def tripled(x):
    """x three times."""
    return 3.0 * x


@kernel
def combined(a, b):
    """A sum."""
    return tripled(a) + a * b


def test_parts_within_kernels_and_by_themselves():
    assert combined(2.0, 5.0) == 16.0
    assert tripled(2.0) == 6.0
    assert (combined.__name__, combined.__doc__) == ("combined", "A sum.")


def test_nothing_is_fused_behind_the_reader_s_back():
    def difference(a, b, c):
        return a * b - c

    def fused(a, b, c):
        return fma(a, b, -c)

    a, b = 1.0 + 2.0**-30, 1.0 - 2.0**-30
    assert kernel(difference)(a, b, a * b) == 0.0
    assert kernel(fused)(a, b, a * b) == -(2.0**-60)
