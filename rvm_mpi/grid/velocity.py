"""The velocity grid: nodes, faces, and the slab layout in which kernels walk through it.

Velocity always has three axes (x, y, z), an unused one a single node at zero with weight one. The block of a cell is
stored as one slab of (y, z) nodes after another, x slowest; a slab is padded with zeros to whole vectors of eight, so
that block = points_x * slab_size doubles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rvm_mpi.compiling.simd import LANES

#: rows of `VelocityGrid.slab`
Y, Z, Y_FACE, Z_FACE, VALID, Y_LEAST, Y_OPEN, Z_LEAST, Z_OPEN, EDGE, SPEED2 = range(11)
Y_FIRST, Y_LAST, Y_BEND, Z_FIRST, Z_LAST, Z_BEND, Z_TAPS = range(11, 18)
#: smallest product of two differences that makes a slope (`limiter.van_leer3`)
LEAST = 1e-180
#: nodes around a face that the widest reconstruction takes
TAPS = 8


@dataclass(frozen=True)
class VelocityGrid:
    """A uniform grid of cell centres over [-V, V] in each direction.

    Attributes
    ----------
    dimensions : int
        d_v, 1 to 3.
    points, half_width, spacing : tuple of three
        Nodes, V and h of each axis; (1, 0, 1) for an unused one.
    slab_points, slab_size, block : int
        (y, z) nodes of a slab, the same padded to whole vectors, and doubles a cell.
    weight : float
        Volume of a velocity cell, the product of the spacings of the axes in use, times the unit of density that values
        on the grid are kept in: their sum times this is the density.
    x, x_face : (points_x,) array
        Nodes, and the face above each (the last one, the edge of the box, is closed).
    slab : (17 + TAPS, slab_size) array
        Rows Y, Z: nodes; Y_FACE, Z_FACE: the face above in y and in z, 0 where it is the edge of the box; VALID: 1 for
        a node, 0 for padding; Y_LEAST, Z_LEAST: what the product of the differences to both neighbours must exceed for
        a slope, infinite where one is missing; Y_OPEN, Z_OPEN: 1 where the face above is inside the box;
        EDGE: 1 for the outermost nodes in y or z; SPEED2: xi_y^2 + xi_z^2; Y_FIRST, Y_LAST, Z_FIRST, Z_LAST: -1 where
        the face above is the lowest or the highest one inside the box; Y_BEND, Z_BEND: -1/24 where it is inside;
        from Z_TAPS on: 1 where the nodes around the face above in z exist, from TAPS/2 below it to TAPS/2 above.
    nodes : (3, longest axis in whole vectors) array
        Nodes of each axis, zero behind its last one.
    """

    dimensions: int
    points: tuple[int, int, int]
    half_width: tuple[float, float, float]
    spacing: tuple[float, float, float]
    slab_points: int
    slab_size: int
    block: int
    weight: float
    x: np.ndarray
    x_face: np.ndarray
    slab: np.ndarray
    nodes: np.ndarray

    @classmethod
    def create(cls, points: tuple[int, ...], half_width: tuple[float, ...], density: float = 1.0) -> VelocityGrid:
        """The grid with the given number of points and half width in each direction in use, and unit of density."""
        unused = 3 - len(points)
        nx, ny, nz = (*points, *(1,) * unused)
        widths = (*(float(v) for v in half_width), *(0.0,) * unused)
        spacing = tuple(2 * v / n if v > 0 else 1.0 for v, n in zip(widths, (nx, ny, nz)))
        axes = [(2 * np.arange(n) + 1 - n) * (0.5 * h) for n, h in zip((nx, ny, nz), spacing)]
        slab_points = ny * nz
        slab_size = -(-slab_points // LANES) * LANES
        j, k = np.divmod(np.arange(slab_points), nz)
        slab = np.zeros((Z_TAPS + TAPS, slab_size))
        inner = slice(0, slab_points)
        slab[Y, inner], slab[Z, inner] = axes[1][j], axes[2][k]
        slab[Y_FACE, inner] = (2 * j + 2 - ny) * (0.5 * spacing[1]) * (j < ny - 1)
        slab[Z_FACE, inner] = (2 * k + 2 - nz) * (0.5 * spacing[2]) * (k < nz - 1)
        slab[VALID, inner] = 1.0
        slab[[Y_LEAST, Z_LEAST]] = np.inf
        slab[Y_LEAST, np.flatnonzero((j > 0) & (j < ny - 1))] = LEAST
        slab[Z_LEAST, np.flatnonzero((k > 0) & (k < nz - 1))] = LEAST
        slab[Y_OPEN, inner], slab[Z_OPEN, inner] = j < ny - 1, k < nz - 1
        for row, there in ((Y_FIRST, j == 0), (Y_LAST, j == ny - 2), (Z_FIRST, k == 0), (Z_LAST, k == nz - 2)):
            slab[row, inner] = np.where(there, -1.0, 0.0)
        slab[[Y_BEND, Z_BEND]] = slab[[Y_OPEN, Z_OPEN]] / -24.0
        outermost = ((ny > 1) & ((j == 0) | (j == ny - 1))) | ((nz > 1) & ((k == 0) | (k == nz - 1)))
        slab[EDGE, inner], slab[SPEED2, inner] = outermost, axes[1][j] ** 2 + axes[2][k] ** 2
        for tap in range(TAPS):
            there = k + tap + 1 - TAPS // 2
            slab[Z_TAPS + tap, inner] = (there >= 0) & (there < nz)
        nodes = np.zeros((3, -(-max(nx, ny, nz) // LANES) * LANES))
        for axis, values in enumerate(axes):
            nodes[axis, : values.size] = values
        return cls(
            dimensions=len(points),
            points=(nx, ny, nz),
            half_width=(widths[0], widths[1], widths[2]),
            spacing=(spacing[0], spacing[1], spacing[2]),
            slab_points=slab_points,
            slab_size=slab_size,
            block=nx * slab_size,
            weight=density * float(np.prod(spacing[: len(points)])),
            x=axes[0],
            x_face=(2 * np.arange(nx) + 2 - nx) * (0.5 * spacing[0]),
            slab=slab,
            nodes=nodes,
        )

    def unpack(self, block: np.ndarray) -> np.ndarray:
        """A view of blocks (..., block) as (..., points_x, points_y, points_z), without the padding."""
        nx, ny, nz = self.points
        slabs = block.reshape(*block.shape[:-1], nx, self.slab_size)[..., : self.slab_points]
        return slabs.reshape(*block.shape[:-1], nx, ny, nz)
