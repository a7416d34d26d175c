"""The collision operators, as compiled kernels on the velocity block of one cell."""
