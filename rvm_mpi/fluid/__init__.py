"""The macroscopic system: Euler equations of a (granular) gas, d + 2 components, by WENO5."""

from rvm_mpi.fluid.system import FluidSystem, PositivityLost
from rvm_mpi.fluid.walls import GHOSTS

__all__ = ["GHOSTS", "FluidSystem", "PositivityLost"]
