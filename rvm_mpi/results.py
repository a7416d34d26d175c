"""The results of a run, for scripts and notebooks; needs no MPI.

from rvm_mpi.results import open_run, read_history
"""

from rvm_mpi.output.read import open_run, read_history

__all__ = ["open_run", "read_history"]
