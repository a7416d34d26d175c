"""Results read by other processes, again and again, while the run writes them: neither notices the other."""

import subprocess
import sys
import time

import pytest
from faults.faulty import ROOT, Started, assert_same

pytestmark = pytest.mark.timeout(600)

#: reads as a plotting script does, until a file says stop; prints how often, and what it saw that was not whole
READER = """
import sys, time
import numpy as np
from pathlib import Path
way, run, stop = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
import h5py
from rvm_mpi.results import open_run, read_history
reads, seen = 0, set()
while not stop.exists():
    if not (run / "fields.h5").exists() or not (run / "history.csv").exists():
        time.sleep(0.005)
        continue
    if way == "open_run":
        fields = open_run(run)
        for name in fields:
            assert np.isfinite(fields[name]).all(), name
        times = fields.time.values
        history = read_history(run)
        assert (np.diff(history["step"]) == 1).all()
    else:  # with HDF5's own locks, as anyone's script would
        with h5py.File(run / "fields.h5", "r") as file:
            stored = np.isfinite(file["time"][()])
            times = file["time"][()][stored]
            for name in ("kinetic/density", "kinetic/stress", "fluid/density", "wall/y-lower/pressure"):
                assert np.isfinite(file[name][: len(stored)][stored]).all(), name  # h5py 3.6 takes no mask of one axis
            time.sleep(0.02)
    reads += 1
    seen.add(len(times))
print(reads, *sorted(seen))
"""


@pytest.mark.parametrize("ranks", [2, pytest.param(1, marks=pytest.mark.long)])
def test_reading_while_the_run_writes(place, whole, ranks, tally):
    directory, stop = place / "run", place / "stop-reading"
    readers = [
        subprocess.Popen(
            [sys.executable, "-c", READER, way, directory, stop],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for way in ("open_run", "h5py")
    ]
    try:
        time.sleep(1.0)
        slow = ["0.2:fields:all:each", "0.1:time:all:each", "0.05:step:all:each"]
        arguments = ["run", place / "job.toml", "--output", directory, "--quiet"]
        with Started(ranks, slow, *arguments, log=place / "log") as started:
            assert started.wait() == 0, (place / "log").read_text()
            assert started.lines() == []
        stop.touch()
        for reader in readers:
            said, complaint = reader.communicate(timeout=60)
            assert reader.returncode == 0, complaint
            reads, *seen = map(int, said.split())
            assert reads > 10
            assert len(seen) > 2  # it saw the file grow
            tally["reads of results that were being written"] += reads
    finally:
        for reader in readers:
            reader.kill()
    assert_same(directory, whole)
