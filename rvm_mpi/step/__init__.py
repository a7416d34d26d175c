"""One time step of the kinetic equation."""
