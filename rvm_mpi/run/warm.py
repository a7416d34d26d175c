"""Compiling all kernels before they are needed: `rvm compile`, and the first run on a machine.

Small jobs that between them call every kernel are run for a step, by one process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rvm_mpi.agree import NotCompiled, agreed
from rvm_mpi.compiling.declare import all_compiled, note_all_compiled
from rvm_mpi.job.job import Job

_SHORT = {"initial": {"state": "uniform"}, "time": {"end": 1e-3, "max_steps": 1}}
_WALL = {"kind": "maxwell", "accommodation": 0.5}
_GAS = {"operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.9}
_SPHERES = {"operator": "boltzmann", "knudsen": 1.0, "restitution": 0.9, "penalise": True}
_LAW = {"relaxation": {"coefficient": 1.0, "density_power": 1, "temperature_power": 0.5}}

#: what is compiled, and the jobs that do it
JOBS: dict[str, tuple[dict[str, Any], ...]] = {
    "kinetic stages and moments": (
        {
            "space": {"cells": [4, 4], "boundary": {"x": _WALL, "y": "far-field"}},
            "velocity": {"points": [8, 8, 8]},
            "collision": _GAS,
            "fluid": {"enabled": True},
            "output": {"marginals": True},
        },
        {
            "space": {"cells": [4], "boundary": {"x": "far-field"}},
            "velocity": {"points": [8, 8]},
            "scaling": {"kind": "thermal"},
            "collision": _GAS,
        },
    ),
    "the fluid system": (
        {
            "space": {"cells": [4], "boundary": {"x": {"lower": "outflow", "upper": "vacuum"}}},
            "velocity": {"points": [8]},
            "collision": _GAS | _LAW,
            "scaling": {"kind": "macroscopic", "synchronise": 1.0},
        },
        {
            "space": {"cells": [4, 4], "boundary": {"x": "outflow", "y": _WALL}},
            "velocity": {"points": [8, 8]},
            "collision": _GAS,
            "scaling": {"kind": "macroscopic", "synchronise": 1.0},
        },
    ),
    "the Boltzmann operator": (
        {
            "space": {"cells": []},
            "velocity": {"points": [16, 16], "half_width": 9.0},
            "collision": _SPHERES,
            "scaling": {"kind": "macroscopic"},
            "initial": {"state": "two-gaussians"},
        },
        {"space": {"cells": [4]}, "velocity": {"points": [16], "half_width": 9.0}, "collision": _SPHERES},
        {"space": {"cells": [4, 4]}, "velocity": {"points": [8, 8, 8], "half_width": 7.0}, "collision": _SPHERES},
    ),
}


def compile_kernels(say: Callable[[str], None]) -> None:
    """Compile every kernel that is not on disk yet.

    Parameters
    ----------
    say : callable
        Told in a line what comes next.
    """
    from mpi4py import MPI

    from rvm_mpi.simulation import Simulation

    for number, (what, jobs) in enumerate(JOBS.items(), 1):
        say(f"compiling kernels, {number} of {len(JOBS)}: {what}")
        for tables in jobs:
            job = Job.from_dict({**_SHORT, **tables}, name="compile")
            simulation = Simulation(job, comm=MPI.COMM_SELF)
            simulation.advance()
            simulation.snapshot()
    note_all_compiled()


def prepare(comm: Any, say: Callable[[str], None]) -> None:
    """Have one rank of each node compile what is not on disk yet, the others wait; collective.

    Raises
    ------
    NotCompiled
        On every rank if one could not, for whatever reason.
    """
    from mpi4py import MPI

    from rvm_mpi.grid.domain import start_petsc

    start_petsc()  # by all ranks: the small jobs are those of single ones
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    compiles = node.rank == 0
    node.Free()
    with agreed(comm, lambda why: NotCompiled(f"the kernels cannot be compiled: {why} (rank {comm.rank})")):
        if compiles and not all_compiled():
            compile_kernels(say)
