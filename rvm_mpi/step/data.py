"""What the kernels of a step take and leave: named numbers and arrays.

Sums over the velocity grid are plain sums over its nodes, without the volume of a velocity cell.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rvm_mpi.compiling.declare import part
from rvm_mpi.grid.domain import aligned
from rvm_mpi.grid.velocity import VelocityGrid, Y
from rvm_mpi.kinetic import drift
from rvm_mpi.kinetic.conservation import SUMS, Correction
from rvm_mpi.kinetic.gaussian import Fit, Gaussian
from rvm_mpi.kinetic.transport import PIECE, Strips

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

#: what a cell's `status` says
HEALTHY, TOO_COLD_FOR_GRID, NO_GAUSSIAN, NO_CORRECTION, NOT_POSITIVE, NOT_A_NUMBER = range(6)

#: what a stage leaves of each cell: the smallest and largest g; the mismatch of its moments that was corrected; 1
#: where a Gaussian had to take the nearest tensor that the grid can hold; sums of max|a|/h over the directions of space
#: and of velocity; energy that collisions took, as far as it counts in the step, and their |d ln E/dt|; shares of mass
#: and energy in the outermost velocities, after a last stage or one of no length; one of the states above
REPORT = np.dtype(
    [
        ("smallest", "f8"),
        ("largest", "f8"),
        ("mismatch", "f8"),
        ("replaced", "f8"),
        ("transport", "f8"),
        ("drift", "f8"),
        ("dissipated", "f8"),
        ("cooling_rate", "f8"),
        ("box_mass", "f8"),
        ("box_energy", "f8"),
        ("status", "i8"),
    ]
)


class Grid(NamedTuple):
    """The velocity grid as numbers and arrays for the kernels (`velocity.py`).

    reconstruction: which of `drift.RECONSTRUCTIONS`; stencil (2, taps): the coefficients of a linear one, and bounded:
    whether its fluxes are kept from making g negative. guard: doubles before and after a block that the drift reads;
    scratch: those of its work space.
    """

    dimensions: int
    points: tuple[int, int, int]
    slab_size: int
    block: int
    below: int
    weight: float
    x: np.ndarray
    x_face: np.ndarray
    slab: np.ndarray
    nodes: np.ndarray
    per_spacing: tuple[float, float, float]
    half_width: tuple[float, float, float]
    reconstruction: int
    stencil: np.ndarray
    bounded: bool
    guard: int
    scratch: int


class Space(NamedTuple):
    """The cells of a rank: counts, ghost widths of g, 1/dx and 1/dy, 0 in an unused direction.

    stops: which of its sides (x lower and upper, y lower and upper) are physical and no mirrors.
    """

    dimensions: int
    nx: int
    ny: int
    wx: int
    wy: int
    per_dx: float
    per_dy: float
    stops: tuple[bool, bool, bool, bool] = (False, False, False, False)


class Model(NamedTuple):
    """What is solved: numbers the kernels branch on or multiply by.

    Attributes
    ----------
    kinetic : bool
        Whether omega follows the carried moments.
    thermal : bool
        Whether it is the thermal speed, and velocities are counted from the gas's mean.
    conservative : bool
        Whether g is corrected to them.
    carried : bool
        Whether moments are carried: for either of these.
    relaxes : bool
        Whether g relaxes to a Gaussian implicitly.
    explicit : bool
        Whether an operator's rate of g is given; what relaxes then is its penalisation.
    nu, relaxation, density_power, temperature_power, cooling : float
        1 - 1/Pr, and the laws of the rates, Knudsen number included.
    courant : float
        The largest Courant number that transport and drift are taken at together: beyond it a cell's drift is taken by
        itself, in as many substeps as it needs.
    """

    kinetic: bool
    thermal: bool
    conservative: bool
    carried: bool
    relaxes: bool
    explicit: bool
    nu: float
    relaxation: float
    density_power: float
    temperature_power: float
    cooling: float
    courant: float


#: Courant number up to which the limiters keep g positive
POSITIVE = 0.5


def physics(job: Job) -> Model:
    """The job's physics as the numbers the kernels take."""
    collision = job.collision
    law, knudsen, prandtl = collision.relaxation, collision.knudsen, collision.prandtl
    collisions = bool(collision.penalise) or (law is not None and knudsen is not None)
    return Model(
        kinetic=job.scaling.kind == "kinetic",
        thermal=job.scaling.kind == "thermal",
        conservative=bool(job.scheme.conservative),
        carried=job.scaling.kind in ("kinetic", "thermal") or bool(job.scheme.conservative),
        relaxes=collisions,
        explicit=collision.explicit,
        nu=1.0 - 1.0 / prandtl if collisions and prandtl is not None else 0.0,
        relaxation=law.coefficient / knudsen if law is not None and knudsen is not None else 0.0,
        density_power=law.density_power if law is not None else 0.0,
        temperature_power=law.temperature_power if law is not None else 0.0,
        cooling=0.0 if collision.explicit else collision.cooling,
        courant=job.time.cfl or POSITIVE,
    )


class Cells(NamedTuple):
    """Fields of the cells at one time level: what a stage reads, and what it writes of the next.

    omega and mean (..., 3), the velocity that xi is counted from, zero but in the thermal scaling, have two ghost cells
    in each direction in use; carried (ny, nx, 5) are rho, rho u, E of f; sums
    (ny, nx, 10) those of 1, xi, xi xi over g's nodes.
    """

    omega: np.ndarray
    mean: np.ndarray
    carried: np.ndarray
    sums: np.ndarray

    @classmethod
    def create(cls, space: Space) -> Cells:
        """Room for the cells of a rank."""
        nx, ny = space.nx, space.ny
        omega = np.ones((ny + 2 * space.wy, nx + 2 * space.wx))
        return cls(omega, np.zeros((*omega.shape, 3)), np.zeros((ny, nx, 5)), np.zeros((ny, nx, 10)))


class Sides(NamedTuple):
    """Rates of mass, momentum and energy through the outermost faces of a rank, along x (2, ny, 5) and y (2, nx, 5).

    Lower side first; counted along +x and +y, per area of face times 1/dx or 1/dy. `through` is what a stage finds and
    leaves; `beyond` is the part of it that no ghost cell's g says (`walls.py`), zero at sides between ranks.
    """

    through_x: np.ndarray
    through_y: np.ndarray
    beyond_x: np.ndarray
    beyond_y: np.ndarray

    @classmethod
    def create(cls, nx: int, ny: int) -> Sides:
        """Zeros for the sides of nx x ny cells."""
        x, y = np.zeros((2, 2, ny, 5)), np.zeros((2, 2, nx, 5))
        return cls(x[0], y[0], x[1], y[1])

    def of(self, side: int) -> tuple[np.ndarray, np.ndarray]:
        """`through` and `beyond` of a side, x lower, x upper, y lower, y upper in order: views (n, 5)."""
        through, beyond = ((self.through_x, self.beyond_x), (self.through_y, self.beyond_y))[side // 2]
        return through[side % 2], beyond[side % 2]


class Fields(NamedTuple):
    """What a stage reads and writes of a rank's cells.

    Attributes
    ----------
    g, old, out : flat arrays
        Ghosted blocks: g of the stage before, g^n, and those that receive the result. The last stage's `out` is g^n's
        own array: a cell of g^n is read before it is written.
    start, begin, new : Cells
        At t^n; of `g`; receives what belongs to `out` (interior of omega, carried, sums).
    growth, omega_end : (ny, nx) arrays
        ln(omega^(n+1)/omega^n)/dt and omega^(n+1), where the scaling does not follow from the kinetic moments.
    turned : (ny, nx, 4) array
        What the stages before the last have turned the thermal scaling's frame by, over dt.
    depth : (ny, nx) array
        Relaxation depth dt tau/eps, averaged over the step; the first stage writes it. Under an explicit operator it is
        given: that of the penalisation.
    source, heating : flat array, (ny, nx) array
        Rate of g by an explicit operator, blocks without ghosts, and the rate of f's energy with it.
    report : (ny, nx) array of REPORT
    sides : Sides
    """

    g: np.ndarray
    old: np.ndarray
    out: np.ndarray
    start: Cells
    begin: Cells
    new: Cells
    growth: np.ndarray
    omega_end: np.ndarray
    turned: np.ndarray
    depth: np.ndarray
    source: np.ndarray
    heating: np.ndarray
    report: np.ndarray
    sides: Sides


class Here(NamedTuple):
    """One cell: its indices, those in arrays with ghosts, and where its block begins in ghosted g."""

    j: int
    i: int
    y: int
    x: int
    block: int


class Moments(NamedTuple):
    """Moments of a cell's fluxes and what they make.

    west, east, north (5,) and south (nx, 5): sums of 1, omega xi, omega^2 |xi|^2 over the fluxes through its faces,
    `south` for a row of cells; rate (5,): of mass, momentum and energy.
    """

    west: np.ndarray
    east: np.ndarray
    north: np.ndarray
    south: np.ndarray
    rate: np.ndarray


class Sums(NamedTuple):
    """Sums of a cell's block over the nodes.

    wanted (5,): of 1, xi, |xi|^2/2 in the stage's result; target (5,): what its explicit part is corrected to;
    result (SUMS,): of the explicit part; before (5,): of g^n.
    """

    wanted: np.ndarray
    target: np.ndarray
    result: np.ndarray
    before: np.ndarray


class Work(NamedTuple):
    """Work space of a stage.

    strips: fluxes through faces; result (block,): the explicit part; flow: three blocks with room before and after, for
    a drift in substeps; scratch: of the drift; extremes (16,): two vectors.
    """

    strips: Strips
    result: np.ndarray
    gaussian: Gaussian
    flow: tuple[np.ndarray, np.ndarray, np.ndarray]
    scratch: np.ndarray
    moments: Moments
    sums: Sums
    correction: Correction
    fit: Fit
    extremes: np.ndarray


@part
def here(grid, space, j, i):  # type: ignore[no-untyped-def]
    """The cell (j, i), a ghost cell where an index is negative."""
    y, x = j + space.wy, i + space.wx
    return Here(j, i, y, x, (y * (space.nx + 2 * space.wx) + x) * grid.block)


@part
def lay_out(grid, nx, buffer):  # type: ignore[no-untyped-def]
    """Work space for rows of nx cells in one flat array, and its length; `lay_out.py_func` is it in plain Python.

    One array in place of thirty: numba looks at the type of each argument in each call.
    """
    block, slab_size, points_x = grid.block, grid.slab_size, grid.points[0]
    guarded, at = block + 2 * grid.guard, 0
    west = buffer[at : at + block]
    at += (block + 7) // 8 * 8
    south = buffer[at : at + block * nx]
    at += (block * nx + 7) // 8 * 8
    faces = buffer[at : at + 2 * PIECE]
    at += (2 * PIECE + 7) // 8 * 8
    spare = buffer[at : at + block]
    at += (block + 7) // 8 * 8
    result = buffer[at : at + block]
    at += (block + 7) // 8 * 8
    values = buffer[at : at + block]
    at += (block + 7) // 8 * 8
    flow0 = buffer[at : at + guarded]
    at += (guarded + 7) // 8 * 8
    flow1 = buffer[at : at + guarded]
    at += (guarded + 7) // 8 * 8
    flow2 = buffer[at : at + guarded]
    at += (guarded + 7) // 8 * 8
    scratch = buffer[at : at + grid.scratch]
    at += (grid.scratch + 7) // 8 * 8
    mean = buffer[at : at + 3]
    at += (3 + 7) // 8 * 8
    tensor = buffer[at : at + 6]
    at += (6 + 7) // 8 * 8
    fitted = buffer[at : at + 10]
    at += (10 + 7) // 8 * 8
    moments_west = buffer[at : at + 5]
    at += (5 + 7) // 8 * 8
    moments_east = buffer[at : at + 5]
    at += (5 + 7) // 8 * 8
    moments_north = buffer[at : at + 5]
    at += (5 + 7) // 8 * 8
    moments_south = buffer[at : at + 5 * nx]
    at += (5 * nx + 7) // 8 * 8
    rate = buffer[at : at + 5]
    at += (5 + 7) // 8 * 8
    wanted = buffer[at : at + 5]
    at += (5 + 7) // 8 * 8
    target = buffer[at : at + 5]
    at += (5 + 7) // 8 * 8
    sums = buffer[at : at + SUMS]
    at += (SUMS + 7) // 8 * 8
    before = buffer[at : at + 5]
    at += (5 + 7) // 8 * 8
    extremes = buffer[at : at + 16]
    at += (16 + 7) // 8 * 8
    factor_x = buffer[at : at + points_x]
    at += (points_x + 7) // 8 * 8
    factor_slab = buffer[at : at + slab_size]
    at += (slab_size + 7) // 8 * 8
    powers = buffer[at : at + 5 * points_x]
    at += (5 * points_x + 7) // 8 * 8
    matrix = buffer[at : at + 25]
    at += (25 + 7) // 8 * 8
    centre = buffer[at : at + 3]
    at += (3 + 7) // 8 * 8
    coefficients = buffer[at : at + 5]
    at += (5 + 7) // 8 * 8
    step = buffer[at : at + 5]
    at += (5 + 7) // 8 * 8
    theta = buffer[at : at + 10]
    at += (10 + 7) // 8 * 8
    fourth = buffer[at : at + 75]
    at += (75 + 7) // 8 * 8
    plane = buffer[at : at + 600]
    at += (600 + 7) // 8 * 8
    products = buffer[at : at + 100]
    at += (100 + 7) // 8 * 8
    fit_step = buffer[at : at + 10]
    at += (10 + 7) // 8 * 8
    fit_wanted = buffer[at : at + 10]
    at += (10 + 7) // 8 * 8
    scale = buffer[at : at + 10]
    at += (10 + 7) // 8 * 8
    axis = buffer[at : at + 3]
    at += (3 + 7) // 8 * 8
    inverse = buffer[at : at + 6]
    at += (6 + 7) // 8 * 8
    work = Work(
        Strips(west, south, spare, faces),
        result,
        Gaussian(values, mean, tensor, fitted),
        (flow0, flow1, flow2),
        scratch,
        Moments(moments_west, moments_east, moments_north, moments_south.reshape((nx, 5)), rate),
        Sums(wanted, target, sums, before),
        Correction(factor_x, factor_slab, powers, matrix.reshape((5, 5)), centre, coefficients, step),
        Fit(theta, fourth, plane, products.reshape((10, 10)), fit_step, fit_wanted, scale, axis, inverse),
        extremes,
    )
    return work, at


def work_space(grid: Grid, nx: int) -> np.ndarray:
    """A flat array for `lay_out`."""
    no_memory = np.broadcast_to(np.zeros(()), (2**48,))  # laid out there, its length is seen
    buffer = aligned((lay_out.py_func(grid, nx, no_memory)[1],))
    buffer[:] = 0.0
    return buffer


def kernel_grid(grid: VelocityGrid, reconstruction: str = "van-leer") -> Grid:
    """The grid's numbers and arrays, and the drift's reconstruction by its name, as the kernels take them."""
    y = grid.slab[Y, : grid.slab_points]
    return Grid(
        dimensions=grid.dimensions,
        points=grid.points,
        slab_size=grid.slab_size,
        block=grid.block,
        below=int(np.count_nonzero(y < 0)) if grid.points[1] > 1 else 0,
        weight=grid.weight,
        x=grid.x,
        x_face=grid.x_face,
        slab=grid.slab.reshape(-1),
        nodes=grid.nodes,
        per_spacing=(1 / grid.spacing[0], 1 / grid.spacing[1], 1 / grid.spacing[2]),
        half_width=grid.half_width,
        reconstruction=drift.RECONSTRUCTIONS[reconstruction],
        stencil=drift.coefficients(reconstruction),
        bounded=reconstruction in drift.POSITIVE,
        guard=drift.reach(grid.points[2], grid.slab_size),
        scratch=drift.scratch_size(grid.points, grid.slab_size),
    )
