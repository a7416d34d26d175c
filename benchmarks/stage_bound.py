"""A stage's kernels beside what a C compiler makes of them: `python benchmarks/stage_bound.py 64 64 24 24 8`.

Both take the same numbers through transport, drift, moments, the Gaussian and its mixture with g, cell after cell
(`stage_bound.c`), in turn; their results must agree to round-off. What a stage does besides is left out of both: the
fit of the Gaussian, Newton's steps of its parameters and of the correction, the carried moments, the halo.
"""

import argparse
import ctypes
import json
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from rvm_mpi.compiling.declare import kernel
from rvm_mpi.compiling.simd import splat, store
from rvm_mpi.grid.domain import aligned
from rvm_mpi.grid.velocity import VelocityGrid
from rvm_mpi.kinetic import drift
from rvm_mpi.kinetic.conservation import weighted_sums
from rvm_mpi.kinetic.gaussian import gaussian_moments
from rvm_mpi.kinetic.transport import upper_fluxes
from rvm_mpi.step.sweep import Work, kernel_grid, mix

SOURCE = Path(__file__).with_name("stage_bound.c")
COMPILE = ["cc", "-O3", "-march=native", "-mprefer-vector-width=512", "-fopenmp-simd", "-fno-math-errno"]
COMPILE += ["-fno-trapping-math", "-shared", "-fPIC"]
ROUNDS = 7
#: numbers a cell: moments of both fluxes, sums of the block, sums of the Gaussian
REPORT = 30
OMEGA = (1.0, 1.1, 0.9, 1.05)
PER = np.array([64.0, 48.0])
DT, WEIGHTS, SHARES = 1e-4, (0.5, 0.6), (0.7, 0.2)


@kernel
def _cells(grid, nx, ny, per, row, g, out, first, rates, theta, centre, work, sums, report):  # type: ignore[no-untyped-def]
    points_x, slab_size, x, slab, block = grid.points[0], grid.slab_size, grid.x, grid.slab, grid.block
    factor_x, factor_slab, powers = work.correction[0], work.correction[1], work.correction[2]
    for n in range(0, slab_size, 8):
        store(factor_slab, n, splat(1.0))
    for j in range(-1, ny):
        for i in range(0 if j < 0 else -1, nx):
            cell = first + j * row + i * block
            r = report[j * nx + i if i >= 0 and j >= 0 else nx * ny]
            upper_fluxes(
                g, cell, 0 if j < 0 else block, 0 if i < 0 else row, points_x, slab_size, grid.below, x, slab, OMEGA,
                0.0 if j < 0 else per[0], 0.0 if i < 0 else per[1], work.gaussian if j < 0 else work.west,
                work.gaussian if i < 0 else work.south, max(i, 0) * block, work.faces, work.result, r[:5], r[5:10],
            )  # fmt: skip
            if i < 0 or j < 0:
                continue
            drift.update(g, cell, grid, rates, out, WEIGHTS[0], WEIGHTS[1], DT, work.scratch, work.result)
            weighted_sums(work.result, centre, points_x, slab_size, x, slab, factor_x, factor_slab, powers, sums)
            for q in range(10):
                r[10 + q] = sums[q]
            gaussian_moments(theta, centre, points_x, slab_size, x, slab, work.gaussian, r[20:])
            mix(
                work.result, factor_x, factor_slab, SHARES[0], work.gaussian, SHARES[1], points_x, slab_size, x, slab,
                out, cell, False, work.extremes,
            )  # fmt: skip


class _Case(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_long) for name in ("px", "S", "nz", "below", "row", "nx", "ny")),
        *((name, ctypes.c_void_p) for name in ("x", "x_face", "slab", "omega", "per", "rates", "theta", "centre")),
        *((name, ctypes.c_double) for name in ("dt", "weight_old", "weight_new", "own", "share")),
    )


def compiled(directory: str) -> Any:
    """The C function, compiled in `directory` for this processor."""
    library = Path(directory) / "stage_bound.so"
    subprocess.run([*COMPILE, "-o", library, SOURCE, "-lmvec", "-lm"], check=True)
    return ctypes.CDLL(str(library)).cells


def measure(cells: tuple[int, int], velocity: tuple[int, int, int]) -> dict[str, float]:
    """Nanoseconds a phase-space cell of both, minima of the processor's time over the rounds."""
    velocity_grid = VelocityGrid.create(velocity, (7.0,) * 3)
    grid = kernel_grid(velocity_grid)
    nx, ny = cells
    row, first = (nx + 4) * grid.block, 2 * ((nx + 4) + 1) * grid.block
    size = (ny + 4) * row
    random = np.random.default_rng(1)
    g, start = (aligned((size,), drift.reach(grid.points[2], grid.slab_size)) for _ in range(2))
    for array in (g, start):
        velocity_grid.unpack(array.reshape(-1, grid.block))[...] = random.uniform(
            0.5, 1.5, (size // grid.block, *velocity)
        )
    rates = np.array([0.3, 0.2, 0.1, -0.2, 0.25, 0.01, 0.02, -0.03, *grid.per_spacing])
    theta = np.array([0.1, 0.0, 0.02, 0.01, -0.5, 0.03, -0.02, -0.45, 0.01, -0.55])
    centre, omega = np.array([0.1, -0.05, 0.02]), np.array(OMEGA)
    work, sums = Work.create(grid, nx), np.zeros(14)
    with tempfile.TemporaryDirectory() as directory:
        function = compiled(directory)
    slab = np.ascontiguousarray(grid.slab)
    held = [np.ascontiguousarray(a) for a in (grid.x, grid.x_face, slab, omega, PER, rates, theta, centre)]
    pointers = [a.ctypes.data for a in held]
    case = _Case(
        velocity[0], grid.slab_size, velocity[2], grid.below, row, nx, ny, *pointers, DT, *WEIGHTS, *SHARES
    )

    def by_kernels(out: np.ndarray, report: np.ndarray) -> None:
        _cells(grid, nx, ny, PER, row, g, out, first, rates, theta, centre, work, sums, report)

    def by_c(out: np.ndarray, report: np.ndarray) -> None:
        blocks = (work.west, work.south, work.result, work.gaussian)
        places = [ctypes.c_void_p(a.ctypes.data) for a in (g[first:], out[first:], *blocks, report)]
        function(ctypes.byref(case), *places)

    results, times = [], []
    for run in (by_kernels, by_c):
        out, report = start.copy(), np.zeros((nx * ny + 1, REPORT))
        work.west[:], work.south[:] = 0.0, 0.0
        run(out, report)
        results.append((out, report))
    for mine, other in zip(*results):
        np.testing.assert_allclose(mine, other, rtol=1e-11, atol=1e-12 * np.abs(mine).max())
    out, report = results[0]
    for _ in range(ROUNDS):
        for run in (by_kernels, by_c):
            begin = time.process_time()
            run(out, report)
            times.append(time.process_time() - begin)
    each = 1e9 / (nx * ny * np.prod(velocity))
    return {"kernels_ns": float(min(times[::2]) * each), "c_ns": float(min(times[1::2]) * each)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sizes", nargs=5, type=int, help="cells along x and y, velocities along x, y and z")
    sizes = parser.parse_args().sizes
    print(json.dumps(measure((sizes[0], sizes[1]), (sizes[2], sizes[3], sizes[4]))))


if __name__ == "__main__":
    main()
