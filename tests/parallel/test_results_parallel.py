"""fields.h5 from 1 to 4 ranks: the same bits, nothing lost, and no hang when one rank fails."""

import math
from pathlib import Path

import numpy as np
import pytest

from rvm_mpi import results

PROGRAM = Path(__file__).with_name("results_program.py")


@pytest.fixture
def program(mpirun):
    """Run the program on some ranks and return what it said; a hang is a failure after 60 s."""

    def run(ranks, *arguments, check=True):
        done = mpirun(ranks, PROGRAM, *arguments, timeout=60, env={"PYTHONPATH": str(PROGRAM.parents[2])})
        assert done.returncode == 0 or not check, done.stdout + done.stderr
        return done.stdout

    return run


def expected(name, index, run):
    """The numbers results_program.py writes."""
    names = list(run.attrs["field_order"])
    nx, ny = run.sizes.get("x", 1), run.sizes.get("y", 1)
    y, x = np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij")
    variable = run[name.replace("/", "_")]
    shape = variable.shape[1:]
    per_cell = shape[len([axis for axis in ("x", "y") if axis in variable.dims]) :]
    inner = np.arange(int(np.prod(per_cell, dtype=int))).reshape(per_cell)
    base = (x + 1000 * y + 1e6 * names.index(name) + index / 3).reshape(ny, nx, *(1 for _ in per_cell))
    return (base + inner / 128).reshape(shape)


ORDER = (
    "kinetic/density",
    "kinetic/temperature",
    "kinetic/velocity",
    "kinetic/heat_flux",
    "kinetic/stress",
    "kinetic/pressure_tensor",
    "scaling/omega",
    "fluid/density",
    "fluid/temperature",
    "fluid/velocity",
    "marginal/x",
)


@pytest.mark.parametrize(("cells", "ranks"), [("13x10", (1, 2, 3, 4)), ("13", (1, 2, 3, 4)), ("0D", (1,))])
def test_same_bits_on_any_number_of_ranks(program, tmp_path, cells, ranks):
    runs, sums = [], set()
    for n in ranks:
        directory = tmp_path / str(n)
        directory.mkdir()
        out = program(n, directory, cells, "plain")
        sums.add(next(line for line in out.splitlines() if line.startswith("SUMS")))
        runs.append(results.open_run(directory))
    first = runs[0].assign_attrs(field_order=ORDER)
    assert len(first.data_vars) == 11 + ("x" in cells)
    for name in ORDER:
        for index in range(3):
            assert np.array_equal(
                first[name.replace("/", "_")].values[index], expected(name, index, first)
            ), name
    if "x" in cells:
        assert np.array_equal(first.wall_x_lower_pressure.values, np.arange(10) + np.arange(3)[:, None])
    for other in runs[1:]:
        assert set(other.variables) == set(first.variables)
        for name in first.data_vars:
            assert other[name].values.tobytes() == first[name].values.tobytes(), name
    files = {(tmp_path / str(n) / "fields.h5").read_bytes() for n in ranks}
    assert len(files) == 1  # with the same attributes, the same file
    assert len(sums) == 1
    values = [float.fromhex(text) for text in sums.pop().split()[1:]]
    densities = [expected("kinetic/density", index, first).ravel() / 3 for index in range(3)]
    assert values == [math.fsum(density) for density in densities]


@pytest.mark.parametrize("ranks", [1, 3])
@pytest.mark.parametrize(
    ("case", "message"), [("one-fails", "missing or unknown: kinetic/density"), ("disk-fails", "rite")]
)
def test_when_one_rank_fails_all_say_so_and_the_run_can_go_on(program, tmp_path, ranks, case, message):
    out = program(ranks, tmp_path, "12x9", case)
    caught = [line for line in out.splitlines() if line.startswith("CAUGHT")]
    assert sorted(line.split()[1] for line in caught) == [str(rank) for rank in range(ranks)]
    for line in caught:
        assert f"{tmp_path}/fields.h5 cannot take snapshot 1 at t = 0.5" in line
        assert message in line
        assert (f"(rank {ranks - 1})" in line) is (ranks > 1)
    assert results.open_run(tmp_path).time.values.tolist() == [0.0, 2.0]


@pytest.mark.parametrize("ranks", [1, 3])
def test_a_full_disk_is_noticed_at_the_start(program, tmp_path, ranks):
    out = program(ranks, tmp_path, "12x9", "no-room")
    # ranks may write into each other's lines
    assert out.count("CAUGHT ") == ranks
    assert out.count("fields.h5 cannot be created: [Errno 27] File too large") == ranks
    assert list(tmp_path.iterdir()) == []


def test_a_killed_run_leaves_its_snapshots(program, tmp_path):
    program(2, tmp_path, "12x9", "killed", check=False)
    run = results.open_run(tmp_path).assign_attrs(field_order=ORDER)
    assert run.time.values.tolist() == [0.0, 0.5]
    assert np.array_equal(run.kinetic_heat_flux.values[1], expected("kinetic/heat_flux", 1, run))
