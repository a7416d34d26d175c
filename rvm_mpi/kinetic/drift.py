"""div_xi (a g): the total drift in velocity space, and the update of a cell's block by all explicit terms.

a(xi) = - (A + xi_x . grad omega) xi + beta u, where A = d_t omega / omega + beta holds the scaling's own rate and the
drag's, so that the two cancel as numbers before anything is upwinded. Where velocities are counted from the gas's mean
(the thermal scaling), v/omega = xi_x + m stands for xi_x there, m = u/omega, and a has - (xi_x + m) . grad u besides.
The faces at the edge of the box are closed.

How g is reconstructed on the faces is one of three files' matter: relative to the cell's Maxwellian
(`drift_maxwellian.py`), by Van Leer's limiter (`drift_van_leer.py`), or by linear differences (`drift_linear.py`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rvm_mpi.compiling.declare import part
from rvm_mpi.grid.velocity import TAPS
from rvm_mpi.kinetic import drift_linear, drift_maxwellian, drift_van_leer
from rvm_mpi.kinetic.drift_linear import ORDERS, POSITIVE, stencil, update_linear
from rvm_mpi.kinetic.drift_maxwellian import update_maxwellian
from rvm_mpi.kinetic.drift_speed import guard_of
from rvm_mpi.kinetic.drift_van_leer import update_van_leer, whole_vectors

#: which of the three a name in the job file stands for
VAN_LEER, LINEAR, MAXWELLIAN = range(3)
RECONSTRUCTIONS = {"maxwellian": MAXWELLIAN, "van-leer": VAN_LEER, **dict.fromkeys(ORDERS, LINEAR)}
#: those that keep g positive
KEEP_POSITIVE = ("maxwellian", "van-leer", *POSITIVE)


Vector = tuple[float, float, float]
Shears = tuple[Vector, Vector, Vector, Vector]


class Drift(NamedTuple):
    """a(xi) = push - own xi - sum over directions s of (xi_s + flow_s) (shear_s + rise_s xi), and what g is near there.

    own is A = d_t omega/omega and the drag's rate together; rising and falling are d omega/dx and d omega/dy as
    velocities that go up and down along that direction see it; push is beta u/omega, or -d_t u/omega where velocities
    are counted from u. Then flow is u/omega, and shears (x rising, x falling, y rising, y falling) are the gradients of
    u; else these are zero. centre and temperature are the mean and the temperature of g, fastest is max|a|/h along each
    axis.
    """

    own: float
    rising_x: float
    falling_x: float
    rising_y: float
    falling_y: float
    push: tuple[float, float, float]
    centre: tuple[float, float, float]
    temperature: float
    flow: tuple[float, float]
    shears: Shears
    fastest: tuple[float, float, float]


class Mix(NamedTuple):
    """What becomes of the change: weight_old * old + weight_new * (g + dt * change); `old` as g, with its offset."""

    old: np.ndarray
    weight_old: float
    weight_new: float
    dt: float


def scratch_size(points: tuple[int, int, int], slab_size: int) -> int:
    """Doubles of work space: rows of a slab, zeros before and after each, and numbers for each node along x."""
    row = slab_size + 2 * int(guard_of.py_func(points[2]))
    van_leer = drift_van_leer.ROWS * row + points[0] * int(whole_vectors.py_func(points[2]))
    linear = drift_linear.ROWS * row + 3 * TAPS
    maxwellian = drift_maxwellian.ROWS * row + drift_maxwellian.FACTORS * int(whole_vectors.py_func(points[0]))
    return max(van_leer, linear, maxwellian)


def reach(points_z: int, slab_size: int) -> int:
    """How many doubles before and after a block the drift reads; what it finds there must be numbers."""
    return 3 * slab_size + points_z + 16


def coefficients(reconstruction: str) -> np.ndarray:
    """`stencil` of a linear reconstruction, zeros for the others."""
    order = ORDERS.get(reconstruction, 0)
    return stencil(order) if order else np.zeros((2, TAPS))


@part
def apply(g, cell, grid, drift, mix, scratch, result):  # type: ignore[no-untyped-def]
    """result = the mix of g + dt * (result + drift) with an old block, for one cell.

    Parameters
    ----------
    g : (n,) array
        Blocks; this cell's begins at `cell`, which is also its offset in `mix.old`.
    grid : data.Grid
    drift : Drift
    mix : Mix
    scratch : (scratch_size,) array
        Work space; zeros between its rows.
    result : (block,) array
        The rate of change by transport (`transport.py`); receives the new block.
    """
    if grid.reconstruction == MAXWELLIAN:
        update_maxwellian(g, cell, grid, drift, mix, scratch, result)
    elif grid.reconstruction == LINEAR:
        update_linear(g, cell, grid, drift, mix, scratch, result)
    else:
        update_van_leer(g, cell, grid, drift, mix, scratch, result)
