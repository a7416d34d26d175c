"""The terms of the kinetic equation on the grid of one cell, as compiled kernels."""
