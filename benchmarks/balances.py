"""What runs hold of mass, momentum and energy over 10,000 steps: `python benchmarks/balances.py` (some minutes).

Five operators, scalings, walls and numbers of dimensions on small grids, in 25 runs in which each pair of two of these
comes together once (a Graeco-Latin square). Errors are the largest of the whole history, relative as in
`history.csv`; a run that ends before says how.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from rvm_mpi import Simulation
from rvm_mpi.step.failure import NumericalFailure
from tests.verification.kinetic_cases import build, es_bgk

WALL = {"kind": "maxwell", "accommodation": 0.7, "temperature": 1.2}
DIMENSIONS: dict[str, tuple[list[int], list[int], float]] = {
    "0D/2V": ([], [16, 16], 7.0),
    "1D/1V": ([12], [24], 7.0),
    "1D/2V": ([10], [14, 12], 7.0),
    "2D/2V": ([6, 5], [12, 12], 7.0),
    "2D/3V": ([4, 3], [10, 10, 8], 7.0),
}
SCALINGS: dict[str, tuple[str, bool]] = {
    "kinetic": ("kinetic", True),
    "macroscopic, conservative": ("macroscopic", True),
    "macroscopic (the paper's)": ("macroscopic", False),
    "none, conservative": ("none", True),
    "none": ("none", False),
}
WALLS = ("periodic", "specular", "maxwell", "far-field", "outflow")


def collisions(operator: str, d: int) -> dict[str, Any]:
    """The `collision` table of an operator in d velocity dimensions: mean free paths of some cells, weak cooling."""
    law = {"coefficient": 1.0, "density_power": 1.0, "temperature_power": 0.5}
    return {
        "none": {"operator": "none"},
        "es-bgk": es_bgk(0.5, 1.0, 1.0, 0.5),
        "granular-es-bgk": {"operator": "granular-es-bgk", "knudsen": 1.0, "restitution": 0.98, "relaxation": law},
        "boltzmann": {"operator": "boltzmann", "knudsen": 1.0, "restitution": 1.0},
        "boltzmann, e = 0.98": {"operator": "boltzmann", "knudsen": 1.0, "restitution": 0.98},
    }[operator]


OPERATORS = ("none", "es-bgk", "granular-es-bgk", "boltzmann", "boltzmann, e = 0.98")


def make_job(dimensions: str, operator: str, scaling: str, wall: str, steps: int) -> Any:
    """The job of one line of the table."""
    cells, points, half_width = DIMENSIONS[dimensions]
    kind, conservative = SCALINGS[scaling]
    sides = dict.fromkeys("xy"[:len(cells)], WALL if wall == "maxwell" else wall)
    if cells:
        initial: dict[str, Any] = {"state": "random-density", "low": 0.5, "seed": 1}
        time = {"end": 1e9, "max_steps": steps}
    else:
        d = len(points)
        stress = [[(1.3 if i == 0 else 0.7) if i == j else 0.0 for j in range(d)] for i in range(d)]
        initial, time = {"state": "uniform", "stress": stress}, {"end": 1e9, "dt": 0.02, "max_steps": steps}
    return build(
        space={"cells": cells, "boundary": sides},
        velocity={"points": points, "half_width": half_width},
        scaling=kind,
        scheme={"conservative": conservative},
        collision=collisions(operator, len(points)),
        initial=initial,
        time=time,
    )


def worst_balances(job: Any) -> tuple[int, float, float, float, float, str]:
    """Steps made; the largest errors of mass, momentum and energy and correction on the way; how it ended."""
    simulation = Simulation(job)
    names, worst, end = ("mass_error", "momentum_error", "energy_error", "correction"), [0.0] * 4, ""
    try:
        for _ in simulation:
            row = simulation.diagnostics.row
            worst = [max(value, abs(row[name])) for value, name in zip(worst, names)]
    except NumericalFailure as failure:
        end = str(failure).split(" in cell")[0]
    return simulation.number, worst[0], worst[1], worst[2], worst[3], end


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--operator", nargs="+", choices=OPERATORS, default=OPERATORS, help="lines of these alone")
    given = parser.parse_args()
    print("| dimensions | operator | scaling | wall | steps | mass | momentum | energy | correction | |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for operator in given.operator:
        o = OPERATORS.index(operator)
        for s, scaling in enumerate(SCALINGS):
            dimensions, wall = list(DIMENSIONS)[(2 * o + s) % 5], WALLS[(o + s) % 5]
            job = make_job(dimensions, operator, scaling, wall, given.steps)
            steps, *errors, end = worst_balances(job)
            figures = " | ".join(f"{value:.0e}" for value in errors)
            place = wall if job.space.dimensions else "-"
            print(f"| {dimensions} | {operator} | {scaling} | {place} | {steps} | {figures} | {end} |", flush=True)


if __name__ == "__main__":
    main()
