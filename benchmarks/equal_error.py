"""Rescaled against classical variables at equal error: `python benchmarks/equal_error.py` (half an hour on one core).

Gas of density 1 and temperature 1 beside gas of density 1/2 and temperature R, one space and two velocity dimensions,
BGK, 64 cells, until the hot gas has crossed a quarter of the box. For each R and Knudsen number the velocities of an
axis that bring density and temperature to within a quarter of the error that the cells leave, in the variables where
that is larger, the seconds and the bytes that this takes; the reference is a run in classical variables on 256 cells.
"""

import argparse
import sys
import time
from math import ceil, sqrt
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi import JobError, Simulation
from rvm_mpi.grid.velocity import VelocityGrid
from rvm_mpi.step.failure import NumericalFailure
from tests.verification.kinetic_cases import build, coarsen, es_bgk, line, table

CELLS, REFERENCE_CELLS = 64, 256
#: half widths of the boxes: of g, in thermal speeds; of f, in thermal speeds of the hot gas
RESCALED, CLASSICAL = 7.0, 6.0
#: velocities of an axis: of g, and of f for each sqrt(R)
TRIED = {"kinetic": (8, 12, 16, 20, 24, 32, 40, 48, 64), "none": (4, 6, 8, 12, 16, 20, 24, 32)}
LABELS = {"kinetic": "rescaled", "none": "classical"}
#: above the error that the cells leave
ALLOWED = 1.25
FIGURE_TITLE = "Needed for equal error: gas of temperature 1 beside gas of temperature R"


def solve(ratio: float, scaling: str, cells: int, points: int, knudsen: float, drift: str = "van-leer"):
    """Density and temperature (cells,) at the end, nan where the run fails, and the seconds of a core it took."""
    half_width = RESCALED if scaling == "kinetic" else CLASSICAL * sqrt(ratio)
    job = build(
        space=line(cells, "far-field", -1.0, 1.0),
        velocity={"points": [points, points], "half_width": half_width},
        scaling=scaling,
        scheme={"conservative": True, "drift": drift},
        collision=es_bgk(knudsen, prandtl=1.0),
        initial={
            "state": "riemann",
            "left": {"density": 1.0, "temperature": 1.0},
            "right": {"density": 0.5, "temperature": ratio},
        },
        time={"end": 0.5 / sqrt(ratio)},
    )
    begin = time.process_time()
    try:
        simulation = Simulation(job)
        for _ in simulation:
            pass
    except (JobError, NumericalFailure):  # a Gaussian that does not fit the grid, a g that is not positive
        return (np.full(cells, np.nan),) * 2, time.process_time() - begin
    seconds = time.process_time() - begin
    moments = simulation.moments()
    return (moments["density"][0], moments["temperature"][0]), seconds


def error(found, exact) -> float:
    """The larger of the relative L1 errors of density and temperature."""
    pairs = zip(found, (coarsen(values, CELLS) for values in exact))
    return max(float(np.abs(values - fine).sum() / np.abs(fine).sum()) for values, fine in pairs)


def size(points: int) -> int:
    """Bytes of the two copies of g, ghost cells included."""
    return 2 * 8 * (CELLS + 4) * VelocityGrid.create((points, points), (1.0, 1.0)).block


def needed(ratio: float, knudsen: float, drift: str) -> dict[str, tuple[int, float, float]]:
    """Velocities of a cell, seconds and megabytes of g that bring the error down to what the cells leave."""
    exact, _ = solve(ratio, "none", REFERENCE_CELLS, ceil(16 * sqrt(ratio)) * 2, knudsen)
    errors: dict[str, list[tuple[int, float, float]]] = {}
    for scaling, tried in TRIED.items():
        stretch = sqrt(ratio) if scaling == "none" else 1.0
        reconstruction = drift if scaling == "kinetic" else "van-leer"
        errors[scaling] = []
        for points in (2 * ceil(n * stretch / 2) for n in tried):
            found, seconds = solve(ratio, scaling, CELLS, points, knudsen, reconstruction)
            errors[scaling].append((points, error(found, exact), seconds))
    goal = ALLOWED * max(rows[-1][1] for rows in errors.values())
    print(f"R = {ratio:g}, Knudsen number {knudsen:g}: error allowed {goal:.3g}")
    table("variables velocities_an_axis error seconds", [(LABELS[s], *r) for s in errors for r in errors[s]])
    least = {scaling: next(row for row in rows if row[1] <= goal) for scaling, rows in errors.items()}
    return {scaling: (points**2, seconds, size(points) / 1e6) for scaling, (points, _, seconds) in least.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ratios", type=float, nargs="+", default=[1.0, 4.0, 25.0, 100.0], help="temperature ratios R")
    parser.add_argument("--knudsen", type=float, nargs="+", default=[0.05, 0.005], help="Knudsen numbers")
    parser.add_argument("--drift", default="seventh-order-positive", help="in rescaled variables")
    parser.add_argument("--figure", type=Path, help="file for the plot")
    options = parser.parse_args()
    solve(1.0, "kinetic", CELLS, 8, 1.0, options.drift)  # compiles what is not
    found = {kn: [needed(ratio, kn, options.drift) for ratio in options.ratios] for kn in options.knudsen}
    rows = [
        (f"{kn:g}", f"{ratio:g}", *(value for pair in zip(row["none"], row["kinetic"]) for value in pair))
        for kn, series in found.items()
        for ratio, row in zip(options.ratios, series)
    ]
    print("needed: classical, rescaled")
    table("knudsen R velocities_c velocities_r seconds_c seconds_r MB_c MB_r", rows)
    if options.figure:
        draw(options.ratios, found, options.figure)


def draw(ratios, found, path: Path) -> None:
    """Velocities of a cell, seconds and megabytes against the temperature ratio."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot, ticker

    figure, axes = pyplot.subplots(1, 3, figsize=(10, 3.4), constrained_layout=True)
    names = ("velocities of a cell", "time on one core [s]", "memory of g [MB]")
    for color, (knudsen, series) in zip(("tab:blue", "tab:orange", "tab:green"), found.items()):
        for scaling, mark in (("none", "s--"), ("kinetic", "o-")):
            for place, axis in enumerate(axes):
                label = f"{LABELS[scaling]}, Kn = {knudsen:g}"
                axis.loglog(ratios, [row[scaling][place] for row in series], mark, color=color, label=label)
    for axis, name in zip(axes, names):
        axis.set(xlabel="temperature ratio R", ylabel=name, xticks=ratios, xticklabels=[f"{r:g}" for r in ratios])
        axis.minorticks_off()
        axis.yaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.grid(alpha=0.3)
    axes[0].legend(frameon=False, fontsize="small")
    figure.suptitle(FIGURE_TITLE)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
