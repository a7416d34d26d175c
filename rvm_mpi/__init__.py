"""Parallel solver for kinetic equations in rescaled velocity space.

``Job`` and ``Simulation`` are imported on first use, so that ``import rvm_mpi`` starts neither MPI nor PETSc.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job, JobError
    from rvm_mpi.simulation import Simulation

__version__ = "0.1.0"
__all__ = ["Job", "JobError", "Simulation", "__version__"]

_HOMES = {"Job": "rvm_mpi.job.job", "JobError": "rvm_mpi.job.job", "Simulation": "rvm_mpi.simulation"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'rvm_mpi' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)
