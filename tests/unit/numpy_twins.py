"""What the tests of single kernels compare them with in plain NumPy: sums, fluxes, and terms of `rvm_mpi.reference`.

A distribution is an array (..., points_x, points_y, points_z). `pack` and `VelocityGrid.unpack` go to the
kernels' slabs and back.
"""

from types import SimpleNamespace

import numpy as np

from rvm_mpi.grid.velocity import VelocityGrid
from rvm_mpi.kinetic import drift_speed
from rvm_mpi.kinetic.drift import Drift
from rvm_mpi.reference import Problem, gaussians
from rvm_mpi.reference.drift import Turning, drift
from rvm_mpi.reference.transport import face_values
from rvm_mpi.step.data import kernel_grid, lay_out, work_space

#: velocity grids in one, two and three directions: slabs that need padding and slabs that do not, odd and even counts
SHAPES = [(6,), (7,), (9, 7), (8, 8), (5, 4), (8, 6, 5), (6, 6, 8), (5, 7, 3)]


def make_grid(points, half_width=7.0):
    return VelocityGrid.create(points, (half_width,) * len(points))


def pack(grid, values):
    """Blocks (..., block) of values (..., px, py, pz), the padding zero."""
    values = np.asarray(values)
    nx, ny, nz = grid.points
    lead = values.shape[:-3]
    blocks = np.zeros((*lead, nx, grid.slab_size))
    blocks[..., : ny * nz] = values.reshape(*lead, nx, ny * nz)
    return blocks.reshape(*lead, grid.block)


def laid_out(grid, values, rng):
    """Cells one behind the other as the kernels see them, arbitrary numbers before and behind; and the first offset."""
    guard = -(-(2 * grid.slab_size + grid.points[2] + 16) // 8) * 8
    blocks = pack(grid, values).reshape(-1)
    return np.concatenate([rng.normal(size=guard), blocks, rng.normal(size=guard)]), guard


def random_g(grid, rng, cells=(), signed=False):
    """A rough positive g, over several orders of magnitude; or one of both signs."""
    shape = (*cells, *grid.points)
    return rng.normal(size=shape) if signed else np.exp(2.0 * rng.normal(size=shape))


def nodes(grid):
    """xi_x, xi_y, xi_z, each of three axes."""
    axes = [np.array([v * (2 * i + 1 - n) / n for i in range(n)]) for n, v in zip(grid.points, grid.half_width)]
    return np.meshgrid(*axes, indexing="ij", sparse=True)


def powers(grid, centre=(0.0, 0.0, 0.0)):
    """1, x, y, z, xx, xy, xz, yy, yz, zz about a centre: (10, px, py, pz)."""
    x, y, z = (axis - c for axis, c in zip(nodes(grid), centre))
    one = np.ones(grid.points)
    return np.array([one * m for m in (1.0, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z)])


def ten_sums(grid, g, centre=(0.0, 0.0, 0.0)):
    """Sums of the ten powers over the nodes: (..., 10)."""
    return np.einsum("...ijk,pijk->...p", g, powers(grid, centre))


def five_sums(grid, flux):
    """Sums of a flux times 1, xi, |xi|^2: (..., 5)."""
    p = powers(grid)
    return np.einsum("...ijk,pijk->...p", flux, np.array([*p[:4], p[4] + p[7] + p[9]]))


def upwinded(before, down, up, after, speed):
    """g on the face between down and up, from the side the speed comes from."""
    return np.where(speed > 0.0, *both_sides(before, down, up, after))


def both_sides(before, down, up, after):
    """The value on the face between down and up as each of them sees it."""
    below, above = face_values(np.array([before, down, up, after]))
    return below[0], above[0]


def signed(up, down, xi):
    """Of a pair for velocities that go up and down, the one that holds for each xi."""
    return np.where(xi > 0.0, up, down)


# -- terms of the reference, on a velocity grid without a job --------------------------------------------------


def problem(grid, reconstruction="van-leer"):
    """What the reference's terms in velocity space ask of a problem."""
    job = SimpleNamespace(scheme=SimpleNamespace(drift=reconstruction))
    p = powers(grid)
    five = np.array([*p[:4], 0.5 * (p[4] + p[7] + p[9])])
    h, V = np.array(grid.spacing), np.array(grid.half_width)
    return Problem(job, grid.dimensions, list(nodes(grid)), five, h, V, grid.weight, {})


#: a cell whose velocities are counted from zero: flow, shears
STILL = (np.zeros(3), np.zeros((2, 2, 3)))


def turning_of(rates, state=((0, 0, 0), 1.0), moving=STILL):
    """The reference's `Turning` of one cell.

    rates: A, the gradients of omega along x and y (up, down each), three pushes; state: mean and temperature of the
    Maxwellian; moving: flow (3) and shears along x and y (2, 2, 3), zeros where velocities are counted from zero.
    """
    rates = np.asarray(rates, dtype=float)
    own, gradient, push = np.full((1, 1), rates[0]), rates[1:5].reshape(2, 2, 1, 1), rates[5:].reshape(1, 1, 3)
    mean, temperature = np.reshape(state[0], (1, 1, 3)), np.full((1, 1), state[1])
    turning = Turning(own, gradient, push, mean, temperature)
    if np.any(moving[0]) or np.any(moving[1]):
        turning = turning._replace(flow=moving[0].reshape(1, 1, 3), shears=moving[1].reshape(2, 2, 1, 1, 3))
    return turning


def kernel_drift(grid, rates, state=((0, 0, 0), 1.0), moving=STILL):
    """The kernels' `Drift` of the same; max|a|/h as the stage works it out."""
    grid = kernel_grid(grid)
    own, *rises = map(float, rates[:5])
    push, rises = tuple(map(float, rates[5:])), tuple(rises)
    flow = tuple(map(float, moving[0][:2]))
    shears = tuple(tuple(map(float, one)) for one in moving[1].reshape(4, 3))
    turning = drift_speed.fastest_turning(own, rises, grid.half_width)
    fastest = tuple(drift_speed.fastest_along(grid, push[q], turning, q) for q in range(3))
    if np.any(moving[0]) or np.any(moving[1]):
        fastest = drift_speed.fastest_thermal(grid, own, rises, push, flow, shears)
    mean, temperature = tuple(map(float, state[0])), float(state[1])
    return Drift(own, *rises, push, mean, temperature, flow, shears, fastest)


def drift_rate(grid, g, turning, reconstruction="van-leer", loses=None):
    """-div_xi (a g) of a cell, closed at the edge of the box; loses: see `reference.drift`."""
    loses = g if loses is None else loses
    return drift(problem(grid, reconstruction), g[None, None], turning, loses[None, None])[0, 0]


def gaussian(grid, density, mean, tensor):
    """The exponential of a quadratic with the sum, mean and covariance (d, d) given."""
    d = grid.dimensions
    axes = [x.ravel() for x in nodes(grid)[:d]]
    return gaussians.gaussian(axes, density, np.array(mean[:d]), np.asarray(tensor)).reshape(grid.points)


def corrected(grid, g, target):
    """g times exp(c0 + c . xi + c2 |xi|^2) with the sums of 1, xi, |xi|^2/2 given (5)."""
    return gaussians.corrected(problem(grid), g, target)


def make_work(grid):
    """The work space of a stage, for one cell."""
    return lay_out.py_func(grid, 1, work_space(grid, 1))[0]
