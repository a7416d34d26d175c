"""The macroscopic system: Euler equations of a (granular) gas, d + 2 components, by finite-difference WENO5."""

from rvm_mpi.fluid.euler import GHOSTS, FluidSystem

__all__ = ["GHOSTS", "FluidSystem"]
