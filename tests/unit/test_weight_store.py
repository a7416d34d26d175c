"""Stored Boltzmann weights: the same bits from the cache and anew, never stale, and a cache that cannot stop a run."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rvm_mpi.collisions import weight_store
from rvm_mpi.collisions import weights as boltzmann_weights
from rvm_mpi.collisions.weights import Rows, compute_weights

POINTS, RESTITUTION, EXPONENT = (10, 12), 0.7, 0.5


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache that takes weights of any size."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(weight_store, "STORED_FROM", 0)
    return tmp_path / "cache" / "rvm_mpi"


@pytest.fixture
def computed(monkeypatch):
    """What `compute_weights` was called with, in order."""
    calls = []

    def counting(rows, *arguments):
        calls.append(arguments)
        return compute_weights(rows, *arguments)

    monkeypatch.setattr(weight_store, "compute_weights", counting)
    return calls


def filled(points=POINTS, restitution=RESTITUTION, exponent=EXPONENT):
    rows = Rows.create(points)
    weights = np.full(rows.weight_bytes // 8, np.nan)
    weight_store.fill(weights, rows, points, restitution, exponent)
    return weights


def anew():
    return compute_weights(Rows.create(POINTS), len(POINTS), RESTITUTION, EXPONENT)


def test_the_cache_gives_the_same_bits(cache, computed):
    first, second = filled(), filled()
    assert len(computed) == 1
    assert len(list(cache.iterdir())) == 1
    assert first.tobytes() == second.tobytes() == anew().tobytes()


def test_small_weights_are_not_stored(cache, computed, monkeypatch):
    monkeypatch.setattr(weight_store, "STORED_FROM", anew().nbytes + 1)
    assert filled().tobytes() == filled().tobytes()
    assert len(computed) == 2 and not cache.exists()


def test_each_dependency_is_in_the_name(monkeypatch, tmp_path):
    names = {weight_store.file_name(POINTS, RESTITUTION, EXPONENT)}
    assert names == {weight_store.file_name(POINTS, RESTITUTION, EXPONENT)}
    names |= {
        weight_store.file_name((12, 10), RESTITUTION, EXPONENT),
        weight_store.file_name((10, 12, 4), RESTITUTION, EXPONENT),
        weight_store.file_name(POINTS, np.nextafter(RESTITUTION, 1), EXPONENT),
        weight_store.file_name(POINTS, RESTITUTION, np.nextafter(EXPONENT, 1)),
        weight_store.file_name(POINTS, EXPONENT, RESTITUTION),
    }
    changed = tmp_path / "boltzmann_weights.py"
    formula = Path(boltzmann_weights.__file__).read_text()
    changed.write_text(formula.replace("z = (1 + restitution) / 4", "z = (2 + restitution) / 4"))
    for owner, name, value in (
        (boltzmann_weights, "__file__", str(changed)),
        (np, "__version__", "0"),
        (weight_store.scipy, "__version__", "0"),
        (weight_store, "get_host_cpu_name", lambda: "another"),
        (weight_store.sys, "byteorder", "another"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, value)
            names.add(weight_store.file_name(POINTS, RESTITUTION, EXPONENT))
    assert len(names) == 11


@pytest.mark.parametrize("damage", ["a bit", "cut", "longer", "empty", "a directory"])
def test_a_damaged_file_is_made_anew(cache, computed, damage):
    filled()
    (path,) = cache.iterdir()
    whole = bytearray(path.read_bytes())
    if damage == "a bit":
        whole[1000] ^= 4
    if damage == "a directory":
        path.unlink()
        path.mkdir()
    else:
        path.write_bytes({"cut": whole[:-8], "longer": whole + b"12345678", "empty": b""}.get(damage, whole))
    assert filled().tobytes() == anew().tobytes()
    assert len(computed) == 2
    if damage != "a directory":
        assert filled().tobytes() == anew().tobytes()
        assert len(computed) == 2, "the damaged file was replaced"


@pytest.mark.parametrize("obstacle", ["a file in the way", "no room", "no home"])
def test_a_cache_that_cannot_be_written_does_not_matter(cache, computed, monkeypatch, obstacle):
    if obstacle == "a file in the way":
        cache.parent.write_text("")
    elif obstacle == "no room":
        cache.mkdir(parents=True)

        def full(*_):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(weight_store.Path, "replace", full)
    else:
        monkeypatch.setenv("XDG_CACHE_HOME", "relative")

        def homeless():
            raise RuntimeError("Could not determine home directory.")

        monkeypatch.setattr(weight_store.Path, "home", homeless)
    for _ in range(2):
        assert filled().tobytes() == anew().tobytes()
    assert len(computed) == 2
    if cache.is_dir():
        assert not list(cache.iterdir()), "nothing half written is left"


def test_the_oldest_go_when_the_cache_is_full(cache, computed, monkeypatch):
    size = anew().nbytes + 32
    monkeypatch.setattr(weight_store, "LARGEST_CACHE", 3 * size)
    for number in range(5):
        filled(restitution=number / 10)
        for path in cache.iterdir():  # a file system may keep times to the second
            age = path.stat().st_mtime - 10
            os.utime(path, (age, age))
    left = {path.name for path in cache.iterdir()}
    assert left == {weight_store.file_name(POINTS, number / 10, EXPONENT) for number in (2, 3, 4)}
    monkeypatch.setattr(weight_store, "LARGEST_CACHE", 0)
    filled(restitution=0.9)
    assert len(list(cache.iterdir())) == 1, "the newest stays, however large"


def test_many_processes_at_once(cache):
    """Each gets whole weights while others write and delete the file, and nothing half written is left."""
    program = (
        "import sys, hashlib; sys.path.insert(0, 'tests/unit')\n"
        "from rvm_mpi.collisions import weight_store; weight_store.STORED_FROM = 0\n"
        "from test_weight_store import filled\n"
        "for _ in range(15):\n"
        "    print(hashlib.sha256(filled()).hexdigest())\n"
        "    for file in weight_store.cache_directory().glob('*.weights'):\n"
        "        file.unlink(missing_ok=True)\n"
        "filled()"
    )
    command = [sys.executable, "-c", program]
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    found = {line for process in processes for line in process.communicate(timeout=240)[0].splitlines()}
    assert [process.returncode for process in processes] == [0, 0, 0]
    assert found == {weight_store.DIGEST(anew()).hexdigest()}
    assert len(list(cache.iterdir())) <= 1
