"""Something goes wrong on one rank: all ranks end, in time, with one clear line and status 3; results stay."""

import pytest
from faults.faulty import assert_readable, assert_same, run

from rvm_mpi.output import rundir

pytestmark = pytest.mark.timeout(600)

#: where the exception comes, on which rank, and whether there are checkpoints by then
ERRORS = {
    "compiling": ("error:compile:0:1", False),
    "init": ("error:init:1:1", False),
    "rank 0 at init": ("error:init:0:1", False),
    "opening the results": ("hdf5:open:2:1", False),
    "step": ("error:step:1:6", True),
    "rank 0 in a step": ("error:step:0:6", True),
    "snapshot": ("error:snapshot:2:3", True),
    "fields": ("hdf5:fields:1:3", True),
    "rank 0 in fields": ("hdf5:fields:0:3", True),
    "the time of a snapshot": ("hdf5:time:1:3", True),
    "checkpoint": ("hdf5:blocks:1:4", True),
    "rank 0 in a checkpoint": ("error:create:0:4", True),
}
QUICK = ("compiling", "step", "rank 0 in a step", "fields")


@pytest.mark.parametrize(
    "case", [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in ERRORS]
)
def test_one_rank_fails_and_all_end(place, whole, case, tally):
    fault, saved = ERRORS[case]
    directory = place / "run"
    status, lines = run(3, [fault], place / "job.toml", "--output", directory, log=place / "log")
    assert status == 3, (place / "log").read_text()
    assert len(lines) == 1, (place / "log").read_text()
    assert f"rank {fault.split(':')[2]}" in lines[0]
    assert ("a fault of rank" if "error:" in fault else "Can't synchronously write data") in lines[0]
    tally["faults on one rank of 3"] += 1
    assert bool(rundir.checkpoints(directory)) == saved
    if saved:
        assert_readable(directory, whole)
        status, lines = run(
            2, [], place / "job.toml", "--output", directory, "--restart", "--quiet", log=place / "log"
        )
        assert (status, lines) == (0, []), (place / "log").read_text()
        assert_same(directory, whole)
