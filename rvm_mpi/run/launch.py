"""How this process was started: by which launcher, as which of how many, and how to start it again.

Until MPI is started ranks know each other only through what their launcher has put into the environment. That may be
wrong for MPI: the launcher of another MPI starts processes that do not see each other, and so does `srun` without PMI.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rvm_mpi.job.text import JobError, one_line

_MPI = (
    ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),
    ("MV2_COMM_WORLD_RANK", "MV2_COMM_WORLD_SIZE"),
    ("PMI_RANK", "PMI_SIZE"),
)
"""Variables that hold rank and size: Open MPI's, MVAPICH's, and those of MPICH's, Intel's and other launchers."""
_WIRING = ("PMI_", "PMI2_", "PMIX_", "PALS_")
"""Beginnings of the variables by which MPI finds the other processes."""
_STEPS = ("SLURM_STEP_ID", "SLURM_STEPID")
_STEP = _STEPS[0]
"""Set in each task that srun starts; in a batch script and in salloc's shell there is none, or one of these:"""
_NO_STEP = 0xFFFFFF00
"""From here on the numbers of steps that are no srun's: batch script, interactive shell, extern."""
_MPIRUN = ("mpirun", "mpiexec", "orterun", "prterun")


class LaunchError(JobError):
    """What was started does not fit together; every process finds the same, and rank 0 says it for all."""


class Launch(NamedTuple):
    """What a launcher says of a process.

    Attributes
    ----------
    rank, size : int
        Which of how many processes; 0 and 1 when started alone.
    variable : str
        The environment variable that tells: without it the process would be one of its own. Empty when alone.
    """

    rank: int
    size: int
    variable: str


def launched() -> Launch:
    """What the launcher of this process says, without MPI."""
    for rank, size in _MPI:
        if _number(rank) is not None and _number(size) is not None:
            return Launch(_number(rank) or 0, _number(size) or 1, size)
    step = _number(_STEP)
    if step is not None and step < _NO_STEP:
        sizes = map(_number, ("SLURM_STEP_NUM_TASKS", "SLURM_NTASKS", "SLURM_NPROCS"))
        return Launch(_number("SLURM_PROCID") or 0, next((n for n in sizes if n), 1), _STEP)
    return Launch(_number("PMIX_RANK") or 0, 1, "")


def _number(name: str) -> int | None:
    text = os.environ.get(name, "")
    return int(text) if text.isdecimal() else None


def check_world() -> None:
    """Start MPI.

    Raises
    ------
    LaunchError
        Where several processes were started, but MPI sees this one alone.
    """
    import mpi4py

    launch = launched()
    unwired = any(name in os.environ for name in _STEPS)
    unwired = unwired and not any(name.startswith(_WIRING) for name in os.environ)
    if unwired and launch.size == 1:
        for name in _STEPS:  # by which Open MPI 4 would look for SLURM's PMI, and end where there is none
            os.environ.pop(name, None)
    elif unwired:
        mpi4py.rc.initialize, mpi4py.rc.finalize = False, True
    from mpi4py import MPI

    library = one_line(MPI.Get_library_version().split(",")[0].replace("\0", "").strip())
    if not MPI.Is_initialized():
        if library.startswith("Open MPI"):  # its MPI_Init would end the process, with fifteen lines
            raise _alone(launch, library)
        MPI.Init_thread()
    if MPI.COMM_WORLD.Get_size() == 1 < launch.size:
        raise _alone(launch, library)


def _alone(launch: Launch, library: str) -> LaunchError:
    way = "srun --mpi=pmix, or with mpirun" if launch.variable == _STEP else "that MPI's own mpirun"
    return LaunchError(
        f"{launch.size} processes were started, but MPI ({library}) sees each of them alone: start one run on "
        f"{launch.size} ranks with {way}; for {launch.size} runs of their own, each with its --output, put "
        f"`env -u {launch.variable}` before the command"
    )


# -- starting it again ------------------------------------------------------------------------------------


def again(arguments: Sequence[str], ranks: int) -> str:
    """A shell's line that starts the program with other arguments, as it was started this time.

    That is known from the command line of the parent where it is an mpirun on this machine; `jobs/mpirun.sh` tells its
    name by RVM_MPIRUN. Otherwise it is `mpirun -n RANKS`.
    """
    called = _from_mpirun()
    if not called:
        called = [os.environ.get("RVM_MPIRUN", "mpirun"), "-n", str(ranks)] if ranks > 1 else []
        called += _program()
    return " ".join(map(_quoted, [*called, *arguments]))


def _is_script() -> bool:
    """Whether the command `rvm` itself was called."""
    return Path(sys.argv[0]).name.startswith("rvm")


def _is_module() -> bool:
    """Whether `python -m rvm_mpi` was."""
    return Path(sys.argv[0]) == Path(__file__).parent.with_name("__main__.py")


def _program() -> list[str]:
    """The words that call this program, also where another one has called it from Python."""
    return [sys.argv[0]] if _is_script() else [sys.executable, "-m", "rvm_mpi"]


def _from_mpirun() -> list[str]:
    """The parent's words up to this program's arguments, where it is an mpirun that has started them."""
    try:
        line = Path(f"/proc/{os.getppid()}/cmdline").read_bytes()
    except OSError:
        return []
    words, own = [os.fsdecode(word) for word in line.split(b"\0")[:-1]], sys.argv[1:]
    head = words[: len(words) - len(own)]
    if not own or not head or words[len(head) :] != own or ":" in head or not (_is_script() or _is_module()):
        return []
    if not Path(head[0]).name.startswith(_MPIRUN):
        return []
    return [os.environ.get("RVM_MPIRUN", head[0]), *head[1:]]


def _quoted(word: str) -> str:
    """A word as a shell reads it; bash's own way where it holds what cannot be printed, such as bytes no UTF-8."""
    if word.isprintable():
        return shlex.quote(word)
    plain = (c if " " <= c <= "~" and c not in "'\\" else _octal(c) for c in word)
    return "$'" + "".join(plain) + "'"


def _octal(character: str) -> str:
    return "".join(f"\\{byte:03o}" for byte in os.fsencode(character))
