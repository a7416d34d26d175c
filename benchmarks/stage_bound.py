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
from rvm_mpi.grid.domain import aligned
from rvm_mpi.grid.velocity import VelocityGrid
from rvm_mpi.kinetic.conservation import no_factor, weighted_sums
from rvm_mpi.kinetic.drift import Drift, Mix
from rvm_mpi.kinetic.drift_van_leer import update_van_leer
from rvm_mpi.kinetic.gaussian import gaussian_moments
from rvm_mpi.kinetic.transport import UpperFaces, upper_fluxes
from rvm_mpi.step.data import Space, here, kernel_grid, lay_out, work_space
from rvm_mpi.step.sweep import mix

SOURCE = Path(__file__).with_name("stage_bound.c")
COMPILE = ["cc", "-O3", "-march=native", "-mprefer-vector-width=512", "-fopenmp-simd", "-fno-math-errno"]
COMPILE += ["-fno-trapping-math", "-shared", "-fPIC", "-Wno-psabi"]
ROUNDS = 7
#: numbers a cell: moments of both fluxes, sums of the block, sums of the Gaussian
REPORT = 30
OMEGA = (1.0, 1.1, 0.9, 1.05)
PER = (64.0, 48.0)
DT, WEIGHTS, SHARES = 1e-4, (0.5, 0.6), (0.7, 0.2)
#: what `Drift` takes, but for what Van Leer's limiter does not look at: the Maxwellian, a flow and shears, max|a|/h
RATES = (0.3, 0.2, 0.1, -0.2, 0.25, (0.01, 0.02, -0.03))
NOTHING = (0.0, 0.0, 0.0)
STILL = ((0.0, 0.0), (NOTHING, NOTHING, NOTHING, NOTHING), NOTHING)
THETA = (0.1, 0.0, 0.02, 0.01, -0.5, 0.03, -0.02, -0.45, 0.01, -0.55)
CENTRE = (0.1, -0.05, 0.02)


@kernel
def _cells(grid, space, g, out, report, buffer):  # type: ignore[no-untyped-def]
    work, _ = lay_out(grid, space.nx, buffer)
    strips, correction, gaussian = work.strips, work.correction, work.gaussian
    no_factor(correction)
    for q in range(3):
        correction.centre[q] = CENTRE[q]
    turn, blend = Drift(*RATES, CENTRE, 1.0, *STILL), Mix(out, WEIGHTS[0], WEIGHTS[1], DT)
    row = (space.nx + 2 * space.wx) * grid.block
    for j in range(-1, space.ny):
        for i in range(0 if j < 0 else -1, space.nx):
            cell = here(grid, space, j, i).block
            r = report[j * space.nx + i if i >= 0 and j >= 0 else space.nx * space.ny]
            upper = UpperFaces(
                0 if j < 0 else grid.block, 0 if i < 0 else row,
                0.0 if j < 0 else space.per_dx, 0.0 if i < 0 else space.per_dy, OMEGA,
            )  # fmt: skip
            west, south = strips.spare if j < 0 else strips.west, strips.spare if i < 0 else strips.south
            lower = (west, south, max(i, 0) * grid.block, strips.faces)
            upper_fluxes(g, cell, grid, upper, lower, work.result, r[:5], r[5:10])
            if i < 0 or j < 0:
                continue
            update_van_leer(g, cell, grid, turn, blend, work.scratch, work.result)
            weighted_sums(work.result, correction.centre, grid, correction, work.sums.result)
            for q in range(10):
                r[10 + q] = work.sums.result[q]
            for q in range(10):
                work.fit.theta[q] = THETA[q]
            gaussian_moments(work.fit.theta, correction.centre, grid, gaussian.block, r[20:])
            mix(grid, work, SHARES[0], SHARES[1], out, cell, False)


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
    space = Space(2, nx, ny, 2, 2, *PER)
    row, first = (nx + 4) * grid.block, here.py_func(grid, space, 0, 0).block
    size = (ny + 4) * row
    random = np.random.default_rng(1)
    g, start = (aligned((size,), grid.guard) for _ in range(2))
    for array in (g, start):
        velocity_grid.unpack(array.reshape(-1, grid.block))[...] = random.uniform(
            0.5, 1.5, (size // grid.block, *velocity)
        )
    rates = np.array([*RATES[:5], *RATES[5], *grid.per_spacing])
    buffer = work_space(grid, nx)
    work = lay_out.py_func(grid, nx, buffer)[0]
    strips = work.strips
    with tempfile.TemporaryDirectory() as directory:
        function = compiled(directory)
    numbers = (np.array(a) for a in (OMEGA, PER, rates, THETA, CENTRE))
    held = [np.ascontiguousarray(a) for a in (grid.x, grid.x_face, grid.slab, *numbers)]
    pointers = [a.ctypes.data for a in held]
    case = _Case(
        velocity[0], grid.slab_size, velocity[2], grid.below, row, nx, ny, *pointers, DT, *WEIGHTS, *SHARES
    )

    def by_kernels(out: np.ndarray, report: np.ndarray) -> None:
        _cells(grid, space, g, out, report, buffer)

    def by_c(out: np.ndarray, report: np.ndarray) -> None:
        blocks = (strips.west, strips.south, work.result, work.gaussian.block)
        places = [ctypes.c_void_p(a.ctypes.data) for a in (g[first:], out[first:], *blocks, report)]
        function(ctypes.byref(case), *places)

    results, times = [], []
    for run in (by_kernels, by_c):
        out, report = start.copy(), np.zeros((nx * ny + 1, REPORT))
        strips.west[:], strips.south[:] = 0.0, 0.0
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
