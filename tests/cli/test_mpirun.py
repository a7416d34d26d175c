"""The helper that starts other tests' ranks."""

from pathlib import Path

import pytest

COUNT = "from mpi4py import MPI; c = MPI.COMM_WORLD; n = c.allreduce(1); c.rank or print(c.size, n)"


@pytest.mark.parametrize("ranks", [1, 2, 4])
def test_ranks_are_started_and_heard(mpirun, ranks):
    result = mpirun(ranks, "-c", COUNT)
    assert (result.returncode, result.stdout) == (0, f"{ranks} {ranks}\n"), result.stderr


def test_exit_status_comes_through(mpirun):
    result = mpirun(2, "-c", "from mpi4py import MPI; MPI.Finalize(); raise SystemExit(75)")
    assert result.returncode == 75


def test_a_hang_fails_in_time_and_leaves_no_rank_behind(mpirun, tmp_path):
    hang = "import os, sys, time; open(sys.argv[1] + str(os.getpid()), 'w'); time.sleep(600)"
    with pytest.raises(pytest.fail.Exception, match="no end after"):
        mpirun(2, "-c", hang, f"{tmp_path}/", timeout=3.0)
    pids = [int(path.name) for path in tmp_path.iterdir()]
    assert len(pids) == 2
    assert not [pid for pid in pids if is_running(pid)]


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_both_petsc_and_parallel_hdf5_are_importable(mpirun):
    code = "from petsc4py import PETSc; import h5py; assert h5py.get_config().mpi, PETSc"
    result = mpirun(2, "-c", code)
    assert result.returncode == 0, result.stderr
