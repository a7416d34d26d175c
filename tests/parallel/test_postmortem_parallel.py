"""A run that fails on one of several ranks: all end, one line says where, the last good checkpoint is there."""

import json
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from rvm_mpi.output.hdf5 import open_alone
from rvm_mpi.output.restart import Checkpoint
from rvm_mpi.results import read_history

PROGRAM = Path(__file__).with_name("postmortem_program.py")
CELL, STEP = (11, 7), 4


@pytest.fixture(scope="module")
def failed(mpirun, tmp_path_factory):
    """Ranks -> run directory and what was said."""
    found = {}
    for ranks in (1, 3):
        directory = tmp_path_factory.mktemp("failed") / "run"
        arguments = (PROGRAM, directory, *map(str, (*CELL, STEP)))
        done = mpirun(ranks, *arguments, timeout=240, env={"PYTHONPATH": str(PROGRAM.parents[2])})
        assert done.returncode == 3, done.stderr
        found[ranks] = directory, [line for line in done.stderr.splitlines() if line.startswith("rvm: ")]
    return found


@pytest.mark.timeout(600)
@pytest.mark.parametrize("ranks", [1, 3])
def test_one_line_says_where_and_what_is_left(failed, ranks):
    directory, lines = failed[ranks]
    assert len(lines) == 1
    document = json.loads((directory / "post-mortem.json").read_text())
    rank = document["where"]["rank"]
    assert (rank > 0) is (ranks > 1)  # cell (11, 7) is not rank 0's
    of_rank = f" of rank {rank}" if ranks > 1 else ""
    assert lines[0].startswith(
        f"rvm: poisoned: g is not a number in cell (11, 7) at (0.9583, 0.8333){of_rank}, velocity node (2, 4); step 4 "
    )
    assert "; last healthy: step 3, t = " in lines[0]
    assert "; the checkpoint of step 3 is there for --restart; more in " in lines[0]
    assert document["checkpoint_step"] == 3
    assert read_history(directory)["step"].tolist() == [0, 1, 2, 3]


@pytest.mark.timeout(600)
@pytest.mark.parametrize("ranks", [1, 3])
def test_no_checkpoint_holds_what_is_no_number(failed, ranks):
    directory, _ = failed[ranks]
    names = sorted(path.name for path in directory.glob("checkpoint*"))
    assert names == ["checkpoint-00000002.h5", "checkpoint-00000003.h5"]
    for name in names:
        with Checkpoint(directory / name, MPI.COMM_SELF) as found:
            assert found.numbers["number"] == int(name[-5:-3])
        with open_alone(directory / name, "r") as file:
            assert np.isfinite(file["g"][...]).all() and np.isfinite(file["cells"][...]).all()


@pytest.mark.timeout(600)
def test_the_same_is_known_on_any_number_of_ranks(failed):
    """Moments, g and history; the cells around lie on other ranks."""
    one, three = (json.loads((failed[ranks][0] / "post-mortem.json").read_text()) for ranks in (1, 3))
    for name in ("step", "time", "dt", "stage", "last_step", "history", "g", "marginals"):
        assert one[name] == three[name], name
    cells = [{tuple(cell.pop("cell")): cell for cell in document["cells"]} for document in (one, three)]
    assert len({cell.pop("rank") for cell in cells[1].values()}) > 1
    assert {cell.pop("rank") for cell in cells[0].values()} == {0}
    assert cells[0] == cells[1] and len(cells[0]) == 9
