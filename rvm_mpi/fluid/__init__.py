"""The macroscopic system: Euler equations of a (granular) gas, d + 2 components, by WENO5."""

from rvm_mpi.fluid.euler import GHOSTS, FluidSystem

__all__ = ["GHOSTS", "FluidSystem"]
