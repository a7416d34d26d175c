"""The Boltzmann operator, elastic and inelastic, by the direct sum of the Fourier-Galerkin method.

Kernel |u|^lambda b with a constant cross section b in the sigma representation, constant restitution e:

    xi' = (xi + xi_*)/2 + (1 - e)/4 u + (1 + e)/4 |u| sigma,   u = xi - xi_*.

In d = 1 the sphere is the two points +-1. Constant b in the impact direction with kernel |u| is the same operator in
d = 2 and twice this one in d = 1; hard spheres in d = 3 are constant b here (1/4 for unit diameter).

The weights are those of `weights.py`. Only modes with l, m and l + m all kept enter, so nothing is aliased, and
the operator commutes with translations: that the nodes are cell centres, xi_j = -V + (j + 1/2) h, multiplies mode k by
a phase exp(i k . s), which l + m = k carries from the arguments to the result, so plain transforms do. Q_0 is zero,
not merely small: mass is exact; momentum and energy are to spectral accuracy.

Cells go through in groups of eight, one a lane of a vector, so that every weight is read once for eight cells; where
the last group is not full its last cell stands again. Each group has a transform of its own, planned alike, and groups
go through it, the sum and the transform back in batches that stay in cache. What a cell gets depends on its own values
only, not on where it lies.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyfftw

from rvm_mpi.collisions.weight_store import shared_weights
from rvm_mpi.collisions.weights import SUPPORT, Rows, block_kind, compute_weights, kernel_scale
from rvm_mpi.compiling.declare import kernel, part
from rvm_mpi.compiling.simd import LANES, apart, collect, distribute, load, splat, spread, store, together

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

#: nodes of all cells in a lane of a batch: short enough for the cache, long enough for calls to be cheap
BATCH_NODES = 2048
#: bytes
DOUBLE = 8


class Modes(NamedTuple):
    """The modes -M..M of each axis of eight cells, the cells innermost: ((2 mx + 1)(2 my + 1)(2 mz + 1) 8,) arrays."""

    re: np.ndarray
    im: np.ndarray


class DoubleSum(NamedTuple):
    """What the double sum visits, and its weights.

    Attributes
    ----------
    pairs : (pairs, 4) array
        `Rows.pairs`.
    kind : (blocks,) array
        2 where k's row is not the middle one, plus 1 where l and m have the same row.
    offsets, weights : arrays
        `Rows.offsets`, `compute_weights`.
    """

    pairs: np.ndarray
    kind: np.ndarray
    offsets: np.ndarray
    weights: np.ndarray


@part
def gather(spectrum, start, points, highest, scale, modes):  # type: ignore[no-untyped-def]
    """Modes from a half spectrum, real and imaginary parts apart.

    spectrum, start : (nx, ny, nz // 2 + 1, 8) complex numbers as pairs, from this place of a flat array on
    points, highest : (nx, ny, nz), (mx, my, mz)
    modes : Modes, overwritten
    """
    (nx, ny, nz), (mx, my, mz) = points, highest
    middle = ((mx * (2 * my + 1) + my) * (2 * mz + 1) + mz) * LANES
    for x in range(-mx, mx + 1):
        for y in range(-my, my + 1):
            source = start + ((x + nx * (x < 0)) * ny + y + ny * (y < 0)) * (nz // 2 + 1) * 2 * LANES
            row = (x * (2 * my + 1) + y) * (2 * mz + 1) * LANES
            for z in range(mz + 1):
                n = source + z * 2 * LANES
                real, imaginary = apart(load(spectrum, n), load(spectrum, n + LANES))
                place = row + z * LANES
                store(modes.re, middle + place, real * scale)
                store(modes.im, middle + place, imaginary * scale)
                if z > 0:
                    store(modes.re, middle - place, real * scale)
                    store(modes.im, middle - place, imaginary * -scale)


@part
def scatter(modes, points, highest, spectrum, start):  # type: ignore[no-untyped-def]
    """The half spectrum of the modes after the middle one, in the layouts of `gather`; the rest follows or is zero."""
    (nx, ny, nz), (mx, my, mz) = points, highest
    middle = ((mx * (2 * my + 1) + my) * (2 * mz + 1) + mz) * LANES
    spectrum[start : start + nx * ny * (nz // 2 + 1) * 2 * LANES] = 0.0
    for x in range(-mx, mx + 1):
        for y in range(-my, my + 1):
            target = start + ((x + nx * (x < 0)) * ny + y + ny * (y < 0)) * (nz // 2 + 1) * 2 * LANES
            row = (x * (2 * my + 1) + y) * (2 * mz + 1) * LANES
            for z in range(mz + 1):
                place = row + z * LANES
                if place == 0:
                    continue
                # -k holds the complex conjugate of k
                sign = 1.0 if place > 0 else -1.0
                place = abs(place) + middle
                low, high = together(load(modes.re, place), load(modes.im, place) * sign)
                store(spectrum, target + z * 2 * LANES, low)
                store(spectrum, target + z * 2 * LANES + LANES, high)


@part
def add_line(weights, start, count, g, q, line):  # type: ignore[no-untyped-def]
    """q[place] += sum_j weights[start + j] g[left + j] g[right - j]: complex g, real weights, eight cells.

    line : places left, right and place in g, g and q; j counts modes
    """
    left, right, place = line
    zero = splat(0.0)
    r1, r2, i1, i2 = zero, zero, zero, zero
    for j in range(count):
        w = spread(weights, start + j)
        a, b = load(g.re, left) * w, load(g.im, left) * w
        c, d = load(g.re, right), load(g.im, right)
        r1, r2 = r1 + a * c, r2 + b * d
        i1, i2 = i1 + a * d, i2 + b * c
        left += LANES
        right -= LANES
    store(q.re, place, load(q.re, place) + (r1 - r2))
    store(q.im, place, load(q.im, place) + (i1 + i2))


@part
def add_two_lines(weights, start, count, g, q, line, centre):  # type: ignore[no-untyped-def]
    """`add_line` for a line upwards and for the line with the opposite modes of the same rows.

    centre : place of mode 0 in the rows of l, of m and of k; those of the line are relative to it.
    """
    left, right, place = line
    zero = splat(0.0)
    r1, r2, i1, i2 = zero, zero, zero, zero
    s1, s2, j1, j2 = zero, zero, zero, zero
    l_up, l_down, m_up, m_down = centre[0] + left, centre[0] - left, centre[1] + right, centre[1] - right
    for j in range(count):
        w = spread(weights, start + j)
        a, b = load(g.re, l_up) * w, load(g.im, l_up) * w
        c, d = load(g.re, m_up), load(g.im, m_up)
        r1, r2 = r1 + a * c, r2 + b * d
        i1, i2 = i1 + a * d, i2 + b * c
        a, b = load(g.re, l_down) * w, load(g.im, l_down) * w
        c, d = load(g.re, m_down), load(g.im, m_down)
        s1, s2 = s1 + a * c, s2 + b * d
        j1, j2 = j1 + a * d, j2 + b * c
        l_up += LANES
        l_down -= LANES
        m_up -= LANES
        m_down += LANES
    up, down = centre[2] + place, centre[2] - place
    store(q.re, up, load(q.re, up) + (r1 - r2))
    store(q.im, up, load(q.im, up) + (i1 + i2))
    store(q.re, down, load(q.re, down) + (s1 - s2))
    store(q.im, down, load(q.im, down) + (j1 + j2))


@part
def add_pairs(double_sum, highest, g, q):  # type: ignore[no-untyped-def]
    """q_k += sum over the pairs of rows of W g_l g_m: the double sum, for eight cells.

    double_sum : DoubleSum
    highest : M of the last axis
    g, q : Modes
    """
    pairs, kind, offsets, weights = double_sum
    length = (2 * highest + 1) * LANES
    for pair in range(pairs.shape[0]):
        block = pairs[pair, 3]
        start = offsets[block]
        mirror, same = kind[block] >= 2, kind[block] % 2 == 1
        l_row = pairs[pair, 0] * length + highest * LANES
        m_row = pairs[pair, 1] * length + highest * LANES
        k_row = pairs[pair, 2] * length + highest * LANES
        centre = (l_row, m_row, k_row)
        for k in range(0 if mirror else 1, highest + 1):
            first = k - highest
            count = (k // 2 if same else highest) - first + 1
            left, right, place = first * LANES, highest * LANES, k * LANES
            if mirror and k > 0:
                add_two_lines(weights, start, count, g, q, (left, right, place), centre)
            else:
                add_line(weights, start, count, g, q, (l_row + left, m_row + right, k_row + place))
            start += count


@kernel
def sum_groups(spectra, groups, points, highest, scale, double_sum, g, q):  # type: ignore[no-untyped-def]
    """The spectra of the first `groups` groups of eight cells, one behind the other, g's in, Q's out."""
    nx, ny, nz = points
    for group in range(groups):
        start = group * nx * ny * (nz // 2 + 1) * 2 * LANES
        gather(spectra, start, points, highest, scale, g)
        q.re[:] = 0.0
        q.im[:] = 0.0
        add_pairs(double_sum, highest[2], g, q)
        scatter(q, points, highest, spectra, start)


@part
def cell_of_lane(cell, ny, nx):  # type: ignore[no-untyped-def]
    """Row and column of a cell of (ny, nx); behind the last one it stands again."""
    return divmod(min(cell, ny * nx - 1), nx)


@kernel
def to_lanes(g, first, groups, places, lanes):  # type: ignore[no-untyped-def]
    """Groups of eight cells from the cell `first` on, as (groups, x, y, z, 8) in the flat array `lanes`.

    g : (ny, nx, x, y, z) array of any strides
    places : (8,) array, overwritten
    """
    ny, nx, points_x, points_y, points_z = g.shape
    by_y, by_x, step_x, step_y, step_z = g.strides
    n = 0
    for group in range(groups):
        for lane in range(LANES):
            j, i = cell_of_lane(first + group * LANES + lane, ny, nx)
            places[lane] = (j * by_y + i * by_x) // DOUBLE
        for x in range(points_x):
            for y in range(points_y):
                row = (x * step_x + y * step_y) // DOUBLE
                for z in range(points_z):
                    store(lanes, n, collect(g, row + z * (step_z // DOUBLE), places))
                    n += LANES


@kernel
def from_lanes(lanes, first, groups, factor, scale, places, factors, out):  # type: ignore[no-untyped-def]
    """`to_lanes` back again, times the cells' factor (ny, nx) and `scale`."""
    ny, nx, points_x, points_y, points_z = out.shape
    by_y, by_x, step_x, step_y, step_z = out.strides
    n = 0
    for group in range(groups):
        for lane in range(LANES):
            j, i = cell_of_lane(first + group * LANES + lane, ny, nx)
            places[lane] = (j * by_y + i * by_x) // DOUBLE
            factors[lane] = factor[j, i] * scale
        scales = load(factors, 0)
        for x in range(points_x):
            for y in range(points_y):
                row = (x * step_x + y * step_y) // DOUBLE
                for z in range(points_z):
                    distribute(out, row + z * (step_z // DOUBLE), places, load(lanes, n) * scales)
                    n += LANES


@dataclass(frozen=True)
class BoltzmannOperator:
    """Q(g, g) on the nodes of a velocity grid, for any number of cells; see the module's docstring.

    In the variables of g: for f(v) = omega^-d g(v / omega) it is C[g] = omega^lambda Q(g, g) / Knudsen number, whose
    factor the caller gives. Two threads must not share one operator, for it owns its buffers.

    Attributes
    ----------
    points : tuple
        Nodes in each direction in use.
    half_width : float
        V, the same in each direction. g should vanish outside the ball of radius 2 V / (3 + sqrt 2).
    restitution, exponent, cross_section : float
        e, lambda and b.
    rows : Rows
        The pairs of rows the sum visits.
    weights : array
        `compute_weights`: read only, so that operators may share them whatever their V and b.
    """

    points: tuple[int, ...]
    half_width: float
    restitution: float
    exponent: float
    cross_section: float
    rows: Rows
    weights: np.ndarray
    _work: dict[str, Any]

    @classmethod
    def create(
        cls,
        points: tuple[int, ...],
        half_width: float,
        restitution: float = 1.0,
        exponent: float = 1.0,
        cross_section: float = 1.0,
        weights: np.ndarray | None = None,
    ) -> BoltzmannOperator:
        """Computes the weights (`Rows.weight_bytes` says how many bytes) unless they are given.

        Raises
        ------
        ValueError
            Where there are not 1 to 3 directions of at least 4 points, e or lambda is outside [0, 1], V or b not
            positive, or the given weights are not as many as the grid's.
        """
        points = tuple(int(n) for n in points)
        if not 1 <= len(points) <= 3 or min(points) < 4:
            raise ValueError(f"points: {points}, wanted 1 to 3 directions of at least 4 points")
        if not (0 <= restitution <= 1 and 0 <= exponent <= 1 and half_width > 0 and cross_section > 0):
            raise ValueError("restitution and exponent must be in [0, 1], half_width and cross_section positive")
        rows = Rows.create(points)
        if weights is None:
            weights = compute_weights(rows, len(points), restitution, exponent)
            weights.flags.writeable = False
        if weights.shape != (int(rows.offsets[-1]),):
            raise ValueError(f"weights: {weights.shape} given, {int(rows.offsets[-1])} wanted")
        operator = cls(
            points=points,
            half_width=float(half_width),
            restitution=float(restitution),
            exponent=float(exponent),
            cross_section=float(cross_section),
            rows=rows,
            weights=weights,
            _work={},
        )
        operator._work.update(operator._buffers())
        return operator

    def _buffers(self) -> dict[str, Any]:
        """Buffers of one batch, and a transform there and back of each group in it.

        The plans are FFTW's estimates, so the same in each run, and the same for all groups, however many are in use.
        """
        shape = (1,) * (3 - len(self.points)) + self.points
        batch = max(1, BATCH_NODES // prod(shape))
        lanes = pyfftw.zeros_aligned((batch, *shape, LANES), dtype="float64", n=64)
        half = (batch, *shape[:2], shape[2] // 2 + 1, LANES)
        spectra = pyfftw.zeros_aligned(half, dtype="complex128", n=64)
        axes = tuple(range(3 - len(self.points), 3))
        options = {"axes": axes, "flags": ("FFTW_ESTIMATE", "FFTW_DESTROY_INPUT"), "threads": 1}
        length = prod(2 * m + 1 for m in self.rows.modes) * LANES
        mirror, same = block_kind(self.rows.keys)
        unused = (slice(None), *(np.newaxis,) * (3 - len(self.points)))
        return {
            "shape": shape,
            "all_axes": {1: (np.newaxis, *unused), 2: (slice(None), *unused)},
            "lanes": lanes.reshape(-1),
            "spectra": spectra.reshape(-1).view(np.float64),
            "forward": [pyfftw.FFTW(*pair, direction="FFTW_FORWARD", **options) for pair in zip(lanes, spectra)],
            "backward": [pyfftw.FFTW(*pair, direction="FFTW_BACKWARD", **options) for pair in zip(spectra, lanes)],
            "modes": [Modes(*pyfftw.zeros_aligned((2, length), dtype="float64", n=64)) for _ in range(2)],
            "double_sum": DoubleSum(self.rows.pairs, 2 * mirror + same, self.rows.offsets, self.weights),
            "places": np.zeros(LANES, dtype=np.int64),
            "factors": np.zeros(LANES),
            "scale": kernel_scale(len(self.points), self.half_width, self.exponent, self.cross_section),
        }

    @property
    def support_radius(self) -> float:
        """R = 2 V / (3 + sqrt 2), outside which g should be negligible."""
        return SUPPORT * self.half_width

    @property
    def nbytes(self) -> int:
        """Bytes of the weights and of the pairs of rows; the buffers come on top, about 60 doubles a node."""
        return self.weights.nbytes + self.rows.nbytes

    def collide(self, g: np.ndarray, out: np.ndarray, factor: np.ndarray | None = None) -> None:
        """Q(g, g) of each cell, times a factor of its own.

        Parameters
        ----------
        g : (cells, *points) or (ny, nx, *points) array of float64
            Of any strides.
        out : array of the same shape
            Overwritten; may be g itself.
        factor : (cells,) or (ny, nx) array
            By which a cell's result is multiplied, 1 if it is not given.
        """
        cells, points = g.shape[: -len(self.points)], g.shape[-len(self.points) :]
        factor = np.ones(cells) if factor is None else factor
        if g.dtype != np.float64 or out.dtype != np.float64:
            raise ValueError(f"collide: {g.dtype} and {out.dtype}, wanted float64")
        if not (points == self.points and 1 <= len(cells) <= 2 and out.shape == g.shape and factor.shape == cells):
            wanted = ", ".join(map(str, self.points))
            raise ValueError(f"collide: {g.shape}, {out.shape} and {factor.shape}, wanted (cells, {wanted})")
        work = self._work
        forward, backward, places, all_axes = work["forward"], work["backward"], work["places"], work["all_axes"]
        g, out = g[all_axes[len(cells)]], out[all_axes[len(cells)]]
        factor = factor.reshape(g.shape[:2])
        for first in range(0, factor.size, len(forward) * LANES):
            groups = min(len(forward), -((first - factor.size) // LANES))
            to_lanes(g, first, groups, places, work["lanes"])
            for transform in forward[:groups]:
                transform.execute()
            sum_groups(
                work["spectra"], groups, work["shape"], self.rows.modes, 1 / prod(self.points),
                work["double_sum"], *work["modes"],
            )  # fmt: skip
            for transform in backward[:groups]:
                transform.execute()
            from_lanes(work["lanes"], first, groups, factor, work["scale"], places, work["factors"], out)


def for_job(job: Job, comm: Any, half_width: float) -> BoltzmannOperator:
    """The operator of a job on a grid of this half width; its weights are shared by the ranks of a node."""
    collision = job.collision
    assert collision.exponent is not None and collision.cross_section is not None
    points = tuple(job.velocity.points)
    restitution = 1.0 if collision.restitution is None else collision.restitution
    weights = shared_weights(comm, points, restitution, collision.exponent)
    return BoltzmannOperator.create(
        points, half_width, restitution, collision.exponent, collision.cross_section, weights
    )
