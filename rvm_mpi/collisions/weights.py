"""Weights of the Fourier-Galerkin Boltzmann operator, and the order in which its double sum walks through them.

On the periodic box [-V, V]^d, with g supported in the ball of radius R = 2 V / (3 + sqrt 2) and the relative velocity
u cut at |u| <= 2 R, the operator acts on the modes of g = sum_k g_k exp(i pi k . xi / V) as

    Q_k = sum_{l + m = k} W(l, m) g_l g_m,   W(l, m) = F(|m - z k|, z |k|) - F(|m|, 0),   z = (1 + e) / 4,

for xi' = xi - z (u - |u| sigma), so that gain and loss are the integrals over u and sigma of |u|^lambda b times
exp(-i pi/V (m - z k) . u) exp(-i pi/V z k . sigma |u|) and exp(-i pi/V m . u). The mean of a plane wave over the
directions of u, or over sigma, is cos, J0 or sin x / x in d = 1, 2, 3, called j(x) here, and one radial integral is
left,

    F(p, q) = b |S^{d-1}|^2 (2 R)^{d + lambda} int_0^1 s^{d - 1 + lambda} j(c p s) j(c q s) ds,   c = 2 pi R / V.

R / V is a constant, so b and V stand in one factor, b (2 R)^{d + lambda} (`kernel_scale`), and the weights kept here
are those without it: they depend on the number of points, e and lambda alone.

As l + m = k, F(|m - z k|, z |k|) depends on |k|^2, |l|^2, |m|^2 alone: integers. W(l, m) + W(m, l) is what a pair of
modes {l, m} needs, and it is real and the same for {-l, -m}.

Modes are grouped in rows along the last axis. A pair of rows needs a block of weights, one for each (k, l) of the last
axis, which depends on the three squares of the rows' own wave vectors only; blocks that are equal are kept once.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, pi, sqrt

import numpy as np
from numpy.polynomial import chebyshev
from scipy.special import j0, roots_jacobi

from rvm_mpi.kinetic_theory import sphere_area

#: radius of the ball that holds g, as a part of the half width V
SUPPORT = 2 / (3 + sqrt(2))


def sphere_mean(dimensions: int, x: np.ndarray) -> np.ndarray:
    """Mean of exp(i a . n) over the unit vectors n in d dimensions, x = |a|."""
    if dimensions == 1:
        return np.cos(x)
    return j0(x) if dimensions == 2 else np.sinc(x / pi)


def terms(wave: float) -> int:
    """Degree of the polynomial that is exp(i wave x) on [-1, 1] to round-off: beyond it the Bessel functions vanish."""
    return ceil(wave + 12 * wave ** (1 / 3)) + 20


def kernel_scale(dimensions: int, half_width: float, exponent: float, cross_section: float) -> float:
    """b (2 R)^(d + lambda): what multiplies the weights."""
    return cross_section * (2 * SUPPORT * half_width) ** (dimensions + exponent)


@dataclass(frozen=True)
class RadialIntegral:
    """F(p, q) of the module's docstring over `kernel_scale`, to about 1e-14 of F(0, 0), for p <= largest, q <= largest.

    Attributes
    ----------
    dimensions : int
    wave : float
        c = 2 pi R / V.
    largest : float
    nodes, weights : (order,) arrays
        Gauss-Jacobi rule for the weight s^{d - 1 + lambda}, with the constants in front of the integral.
    """

    dimensions: int
    wave: float
    largest: float
    nodes: np.ndarray
    weights: np.ndarray

    @classmethod
    def create(cls, dimensions: int, exponent: float, largest: float) -> RadialIntegral:
        """The rule that resolves waves up to `largest`."""
        wave, power = 2 * pi * SUPPORT, dimensions - 1 + exponent
        x, w = roots_jacobi(ceil(terms(wave * largest) / 2), 0.0, power)
        factor = sphere_area(dimensions) ** 2 / 2 ** (power + 1)
        return cls(dimensions, wave, largest, 0.5 * (x + 1), factor * w)

    def rows(self, q: np.ndarray) -> np.ndarray:
        """Chebyshev coefficients of F(p, q), one column for each q, in y = 2 p^2 / largest^2 - 1.

        F is an even entire function of p of exponential type c, so `terms` says how many are needed.
        """
        order = terms(self.wave * self.largest) // 2 + 1
        angle = pi * (np.arange(order) + 0.5) / order
        p = self.largest * np.cos(0.5 * angle)  # y = cos(angle)
        left = sphere_mean(self.dimensions, self.wave * np.outer(p, self.nodes))
        right = sphere_mean(self.dimensions, self.wave * np.outer(self.nodes, q))
        coefficients = np.cos(np.outer(np.arange(order), angle)) @ (left @ (self.weights[:, None] * right))
        coefficients *= 2 / order
        coefficients[0] *= 0.5
        return coefficients

    def evaluate(self, row: np.ndarray, square: np.ndarray) -> np.ndarray:
        """F(sqrt(square), q) from the coefficients of that q."""
        return chebyshev.chebval(2 / self.largest**2 * square - 1, row)


def pair_weights(
    integral: RadialIntegral, restitution: float, kk: np.ndarray, ll: np.ndarray, mm: np.ndarray
) -> np.ndarray:
    """W(l, m) + W(m, l) from |k|^2, |l|^2, |m|^2, integer arrays (n,) with kk ascending."""
    z = (1 + restitution) / 4
    squares, start = np.unique(kk, return_index=True)
    gain = integral.rows(z * np.sqrt(squares))
    length = np.arange(int(max(ll.max(), mm.max())) + 1)
    loss = integral.evaluate(integral.rows(np.zeros(1))[:, 0], length)
    result = np.zeros(kk.size)
    for i, part in enumerate(np.split(np.arange(kk.size), start[1:])):
        if squares[i] == 0:
            continue  # the mass: gain and loss are the same integral
        k, l, m = kk[part], ll[part], mm[part]  # noqa: E741 the paper's letters
        result[part] = integral.evaluate(gain[:, i], (1 - z) * m + z * l + (z * z - z) * k)
        result[part] += integral.evaluate(gain[:, i], (1 - z) * l + z * m + (z * z - z) * k)
        result[part] -= loss[m] + loss[l]
    return result


@dataclass(frozen=True)
class Rows:
    """The pairs of rows of modes that the double sum visits, and the blocks of weights they need.

    A row is a wave vector of all axes but the last, the x axis slowest; modes[axis] is M, the axis holding -M..M, 0
    for an axis not in use (those come first). Of k and -k only one is computed, of {l, m} and {m, l} one is visited.

    Attributes
    ----------
    modes : tuple of three
    pairs : (pairs, 4) int64 array
        Row of l, of m and of k, and the block, in the order of the blocks.
    keys : (blocks, 3) int64 array
        |k|^2, |l|^2, |m|^2 of the rows.
    offsets : (blocks + 1,) int64 array
        Where a block begins among the weights.
    """

    modes: tuple[int, int, int]
    pairs: np.ndarray
    keys: np.ndarray
    offsets: np.ndarray

    @classmethod
    def create(cls, points: tuple[int, ...]) -> Rows:
        """For the given number of points in each direction in use; an even number's Nyquist mode is dropped."""
        mx, my, mz = (0,) * (3 - len(points)) + tuple((n - 1) // 2 for n in points)
        x, y = (a.ravel() for a in np.meshgrid(np.arange(-mx, mx + 1), np.arange(-my, my + 1), indexing="ij"))
        square = x * x + y * y
        base = 4 * int(square.max()) + 1
        pairs, codes = [], []
        for l in range(x.size):  # noqa: E741 the paper's letter
            m = np.flatnonzero((square > square[l]) | ((square == square[l]) & (np.arange(x.size) >= l)))
            kx, ky = x[l] + x[m], y[l] + y[m]
            wanted = (abs(kx) <= mx) & (abs(ky) <= my)
            m, kx, ky = m[wanted], kx[wanted], ky[wanted]
            k = (kx + mx) * (2 * my + 1) + ky + my
            # {l, m} and {-l, -m} belong to k and -k: the rows from the middle on
            half = k >= x.size // 2
            pairs.append(np.stack((np.full(half.sum(), l), m[half], k[half]), axis=1))
            codes.append((square[k[half]] * base + square[l]) * base + square[m[half]])
        code, block = np.unique(np.concatenate(codes), return_inverse=True)
        # large weights then come from memory once for each eight cells, and in order
        by_block = np.argsort(block, kind="stable")
        keys = np.stack((code // base**2, code // base % base, code % base), axis=1)
        sizes = np.array([line_modes(mz, *kind)[0].size for kind in ((0, 0), (0, 1), (1, 0), (1, 1))])
        mirror, same = block_kind(keys)
        return cls(
            modes=(mx, my, mz),
            pairs=np.column_stack((np.concatenate(pairs), block))[by_block].astype(np.int64),
            keys=keys,
            offsets=np.concatenate(([0], np.cumsum(sizes[2 * mirror + same]))).astype(np.int64),
        )

    @property
    def nbytes(self) -> int:
        """Bytes of these tables, without the weights."""
        return self.pairs.nbytes + self.keys.nbytes + self.offsets.nbytes

    @property
    def weight_bytes(self) -> int:
        """Bytes of the weights, known before any is computed; making them takes about eight times that."""
        return 8 * int(self.offsets[-1])

    @property
    def products(self) -> int:
        """Pairs of modes in the double sum of one cell."""
        mirror, same = block_kind(self.keys)
        mz = self.modes[2]
        work = [
            sum(
                (2 if kind[0] and k else 1) * np.count_nonzero(line_modes(mz, *kind)[0] == k) for k in range(mz + 1)
            )
            for kind in ((0, 0), (0, 1), (1, 0), (1, 1))
        ]
        return int(np.array(work)[2 * mirror + same][self.pairs[:, 3]].sum())


def block_kind(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of blocks (blocks, 3): 1 where k's row is not the middle one, and 1 where the rows of l and m are the same."""
    kk, ll, mm = keys.T
    return (kk > 0).astype(np.int64), ((ll == mm) & (kk == 4 * ll)).astype(np.int64)


def line_modes(modes: int, mirror: int, same: int) -> tuple[np.ndarray, np.ndarray]:
    """k and l along the last axis of a block's weights, in the order the sum takes them.

    k from 0 (from 1 in the middle row, whose other half follows from g being real) to M, and for each the l with both
    l and m = k - l in -M..M; where both rows are the same only l <= m. k < 0 has the weights of (-k, -l).
    """
    k, l = np.meshgrid(np.arange(0 if mirror else 1, modes + 1), np.arange(-modes, modes + 1), indexing="ij")  # noqa: E741
    wanted = k - l <= modes
    if same:
        wanted &= 2 * l <= k
    return k[wanted], l[wanted]


def compute_weights(rows: Rows, dimensions: int, restitution: float, exponent: float) -> np.ndarray:
    """All blocks of weights over `kernel_scale`, one behind the other (`Rows.offsets`).

    W(l, m) + W(m, l), or W(l, l) where l = m.
    """
    mirror, same = block_kind(rows.keys)
    mz = rows.modes[2]
    weights = np.zeros(int(rows.offsets[-1]))
    largest = sum(m * m for m in rows.modes)
    base = largest + 1
    codes = np.zeros(weights.size, dtype=np.int64)
    for kind in range(4):
        k, l = line_modes(mz, kind // 2, kind % 2)  # noqa: E741 the paper's letter
        blocks = np.flatnonzero(2 * mirror + same == kind)
        places = rows.offsets[blocks][:, None] + np.arange(k.size)
        kk, ll, mm = (rows.keys[blocks, i][:, None] + n * n for i, n in enumerate((k, l, k - l)))
        codes[places] = (kk * base + np.minimum(ll, mm)) * base + np.maximum(ll, mm)
    code, inverse = np.unique(codes, return_inverse=True)
    kk, ll, mm = code // base**2, code // base % base, code % base
    # |m - z k| <= (1 - z) |m| + z |l| and z |k| are at most the longest mode
    integral = RadialIntegral.create(dimensions, exponent, max(1.0, sqrt(largest)))
    values = pair_weights(integral, restitution, kk, ll, mm)
    values[(ll == mm) & (kk == 4 * ll)] *= 0.5
    weights[:] = values[inverse]
    return weights
