"""A job gives the same bits on any number of ranks: every dataset of fields.h5, and history.csv byte by byte."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from parallel import rank_jobs

PROGRAM = Path(__file__).with_name("rank_jobs.py")
RANKS = (1, 2, 3, 4)


@pytest.fixture(scope="module")
def runs(mpirun, tmp_path_factory):
    """Directories of the runs on 1, 2, 3 and 4 ranks."""
    found = {}
    for ranks in RANKS:
        found[ranks] = tmp_path_factory.mktemp(f"on-{ranks}")
        rank_jobs.write(found[ranks])
        done = mpirun(ranks, PROGRAM, found[ranks], *rank_jobs.JOBS, timeout=240)
        assert done.returncode == 0, done.stdout + done.stderr
    return found


def datasets(path):
    """Name -> values of everything stored in an HDF5 file."""
    found = {}
    with h5py.File(path / "fields.h5") as file:
        file.visititems(lambda name, item: found.update({name: item[...]}) if isinstance(item, h5py.Dataset) else None)
    return found


@pytest.mark.timeout(900)
@pytest.mark.parametrize("job", list(rank_jobs.JOBS))
def test_same_bits_on_1_2_3_and_4_ranks(runs, job):
    one = datasets(runs[1] / job)
    assert {"time", "x", "kinetic/density", "kinetic/heat_flux", "scaling/omega"} <= set(one)
    history = (runs[1] / job / "history.csv").read_bytes()
    assert len(history.splitlines()) > 5
    for ranks in RANKS[1:]:
        other = datasets(runs[ranks] / job)
        assert set(other) == set(one)
        different = [name for name in one if one[name].tobytes() != other[name].tobytes()]
        assert not different, f"on {ranks} ranks"
        assert (runs[ranks] / job / "history.csv").read_bytes() == history, f"on {ranks} ranks"


@pytest.mark.parametrize("job", list(rank_jobs.JOBS))
def test_the_runs_did_something(runs, job):
    """All snapshots are there, whole, and differ: what is compared above is not the initial state."""
    fields = datasets(runs[4] / job)
    times = rank_jobs.JOBS[job].get("output", {}).get("times", [rank_jobs.JOBS[job]["time"]["end"]])
    assert fields["time"].tolist() == times
    for name, values in fields.items():
        assert np.all(np.isfinite(values)), name
    density = fields["kinetic/density"]
    assert np.all(density > 0.0)
    assert np.ptp(density[-1]) > 1e-3
    if len(times) > 1:
        assert np.abs(density[-1] - density[0]).max() > 1e-3
