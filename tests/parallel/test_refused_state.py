"""A state that only one rank's cells show to be unfit: every rank refuses it, at once, with the same line."""

import pytest

PROGRAM = """
import numpy as np
from mpi4py import MPI
from rvm_mpi import Job, JobError, Simulation

job = Job.from_dict({
    "space": {"cells": [16]}, "velocity": {"points": [12, 12], "half_width": 6.0}, "initial": {"state": "uniform"},
    "collision": {"operator": "es-bgk", "knudsen": 0.1}, "time": {"end": 0.5},
})
try:
    Simulation(job, lambda x, y: (np.where(x > 0.95, SICK, 1.0), np.where(x[..., None] > 0.95, FAST, 0.0), 1.0))
    said = "STARTED"
except JobError as error:
    said = f"REFUSED {error}"
everywhere = MPI.COMM_WORLD.gather(said)
if everywhere:
    print("\\n".join(everywhere), flush=True)
"""


@pytest.mark.parametrize("ranks", [1, 2, 3, 4])
@pytest.mark.parametrize(
    ("sick", "fast", "words"), [("1.0", "[6.0, 0.0]", "too few"), ("np.nan", "0.0", "no positive")]
)
def test_all_ranks_refuse(mpirun, ranks, sick, fast, words):
    done = mpirun(ranks, "-c", PROGRAM.replace("SICK", sick).replace("FAST", fast), timeout=60)
    lines = [line for line in done.stdout.splitlines() if line.startswith(("STARTED", "REFUSED"))]
    assert len(lines) == ranks and len(set(lines)) == 1, done
    assert words in lines[0] and "cell (15, 0)" in lines[0]
