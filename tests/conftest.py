"""What all tests share: processes under mpirun that cannot hang and do not spin on a shared core."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# a busy machine draws its cases slowly, too
settings.register_profile("slow machines", suppress_health_check=[HealthCheck.too_slow], deadline=None)
settings.load_profile("slow machines")

ROOT = Path(__file__).resolve().parent.parent
# the system mpi4py's, whatever comes first on the PATH
MPIRUN = os.environ.get("MPIRUN") or shutil.which("mpirun.openmpi") or "mpirun"


def mpi_environment() -> dict[str, str]:
    """Return the environment for a new mpirun, without the traces of one that started pytest itself."""
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("OMPI_", "PMIX_", "PMI_", "PRTE_"))
    }
    return environment | {
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_mpi_yield_when_idle": "1",  # more ranks than cores: wait without spinning
        "OMPI_MCA_btl": "^tcp",  # shared memory only
        "H5PY_ALWAYS_USE_MPI": "1",
        "OMP_NUM_THREADS": "1",
        "NUMBA_NUM_THREADS": "1",
    }


def start_line(ranks: int, *arguments: str | os.PathLike[str], mpirun: Sequence[str] = (MPIRUN,)) -> list[str]:
    """Return the command that starts `ranks` ranks of this Python, also more than there are cores."""
    line = [*mpirun, "-n", str(ranks), "--oversubscribe", "--bind-to", "none", sys.executable]
    return [*line, *(os.fspath(argument) for argument in arguments)]


@pytest.fixture(scope="session")
def mpirun() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run ``mpirun -n ranks python *arguments`` and return returncode, stdout and stderr.

    ``mpirun(2, "-m", "rvm_mpi", "run", job)``, ``mpirun(4, "-c", code)``, ``mpirun(3, script)``; keywords
    `timeout` (seconds; then every rank is killed and the test fails), `cwd` (the project's root) and `env`
    (added to the environment). It checks no return code.
    """
    assert shutil.which(MPIRUN), "no mpirun: see docs/install.md"

    def run(
        ranks: int,
        *arguments: str | os.PathLike[str],
        timeout: float = 120.0,
        cwd: str | os.PathLike[str] = ROOT,
        env: Mapping[str, str] | None = None,
    ) -> subprocess.CompletedProcess[str]:
        line = start_line(ranks, *arguments)
        with subprocess.Popen(
            line,
            cwd=cwd,
            env=mpi_environment() | dict(env or {}),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as process:
            try:
                stdout, stderr = process.communicate(timeout=timeout)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGTERM)  # mpirun ends its ranks, each in a group of its own
                try:
                    stdout, stderr = process.communicate(timeout=10)
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
                    stdout, stderr = process.communicate()
                pytest.fail(f"no end after {timeout} s: {line}\n{stdout}\n{stderr}")
            except BaseException:  # pytest-timeout, Ctrl-C
                os.killpg(process.pid, signal.SIGTERM)
                raise
        return subprocess.CompletedProcess(line, process.returncode, stdout, stderr)

    return run
