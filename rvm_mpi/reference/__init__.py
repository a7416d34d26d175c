"""One whole time step of the kinetic equation in plain NumPy: the scheme to read, and what the kernels are compared to.

    d_t g + div_x(omega xi g) + div_xi(a g) = C[g],   a = -(d_t omega/omega + xi_x . grad omega) xi   (docs/method.md)

or, where velocities are counted from the gas's mean (`thermal.py`), v = u + omega xi for omega xi.

One process, short and slow: whole arrays over cells and velocities, each term beside its equation. Begin with
`scheme.py`, the time integrator; each term is in the file of its name. Arrays of cells are (ny, nx), those of g
(ny, nx, px, py, pz), an unused direction of length one; all is in the job's units. No kernel is imported, and what
constants the kernels have stand here a second time: `tests/verification/test_reference.py` compares the two.

    problem = Problem.of(job, density, velocity, temperature)
    state = step(problem, State(g, omega, U), dt)
"""

from rvm_mpi.reference.scheme import STAGES, Stage, step
from rvm_mpi.reference.state import Problem, State, moments, powers

__all__ = ["STAGES", "Problem", "Stage", "State", "moments", "powers", "step"]
