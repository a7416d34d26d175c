"""Whether a job can start: one function, for `rvm check` and `rvm run` alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rvm_mpi.advice.accuracy import check_grid
from rvm_mpi.advice.first_step import check_first_step
from rvm_mpi.advice.memory import check_weights
from rvm_mpi.advice.velocity_grid import check_box
from rvm_mpi.grid.domain import partition

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job


def check_start(job: Job, ranks: int) -> None:
    """Refuse what cannot start, for `rvm check` and `rvm run` alike.

    The number of ranks, the state, the sides, a grid far too coarse for the operator, the weights, the first step.

    Raises
    ------
    JobError
        Naming the key and what would do.
    """
    partition(job.space.cells, ranks)
    check_box(job)
    check_grid(job)
    check_weights(job)
    check_first_step(job)
