"""Half a run and its other half are the whole run, bit for bit: every operator with every scaling in every dimension.

`restart_program.py` runs the jobs of restart_cases.py; test_restart.py has damage, walls, and what stops a run.
"""

import shutil

import pytest
from parallel.restart_cases import EVERYWHERE, STEPS
from parallel.test_restart import PATIENCE, PROGRAM, assert_same

from rvm_mpi.results import read_history

pytestmark = [pytest.mark.timeout(5 * PATIENCE), pytest.mark.long]


def run(mpirun, ranks, top, what, cases):
    result = mpirun(ranks, PROGRAM, top, what, *cases, timeout=PATIENCE)
    assert result.stdout.split("\n")[:-1] == [f"STATUS {case} 0" for case in cases], result.stderr


@pytest.mark.parametrize(("dimensions", "ranks", "others"), [(0, 1, [1]), (1, 2, [1, 2, 3]), (2, 2, [1, 2, 3])])
def test_a_restart_has_the_same_bits(mpirun, tmp_path, dimensions, ranks, others):
    cases = list(EVERYWHERE[dimensions])
    assert len(cases) == 30
    for what in ("whole", "half"):
        run(mpirun, ranks, tmp_path, what, cases)
    for other in others:
        shutil.copytree(tmp_path / "half", tmp_path / f"on-{other}")
        run(mpirun, other, tmp_path, f"on-{other}", cases)
        for case in cases:
            whole = tmp_path / "whole" / case
            steps = len(read_history(whole)["step"]) - 1  # fewer where only the output times limit a step
            assert STEPS // 2 < steps <= STEPS
            assert_same(whole, tmp_path / f"on-{other}" / case, steps)
