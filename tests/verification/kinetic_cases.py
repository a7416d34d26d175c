"""Jobs of the kinetic verification studies, how they are run, and what is compared.

Used by the tests here at small size and by the scripts in `benchmarks/` at the sizes of docs/results.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rvm_mpi import Job, Simulation


def build(**tables: Any) -> Job:
    """A job from its tables; without a fluid where it can do without, with the kinetic scaling unless they say so."""
    scaling = tables.pop("scaling", "kinetic")
    if isinstance(scaling, str):
        scaling = {"kind": scaling}
    fluid = {"enabled": scaling["kind"] == "macroscopic"}
    return Job.from_dict({"scaling": scaling, "fluid": fluid} | tables)


def line(cells: int, boundary: Any = "periodic", lower: float = 0.0, upper: float = 1.0) -> dict[str, Any]:
    """A `space` table of one dimension."""
    return {"cells": [cells], "lower": [lower], "upper": [upper], "boundary": {"x": boundary}}


def es_bgk(
    knudsen: float, coefficient: float = 1.0, density: float = 1.0, temperature: float = 0.0, **keys: Any
) -> dict[str, Any]:
    """A `collision` table: elastic ES-BGK with tau = coefficient rho^density T^temperature."""
    law = {"coefficient": coefficient, "density_power": density, "temperature_power": temperature}
    return {"operator": "es-bgk", "knudsen": knudsen, "relaxation": law, **keys}


def run(job: Job, initial: Any = None) -> Simulation:
    """Run a job to its end, in memory."""
    simulation = Simulation(job, initial)
    for _ in simulation:
        pass
    return simulation


def fixed_steps(job_of_dt: Any, end: float, steps: int) -> Simulation:
    """Run `job_of_dt(end/steps)` to its end and make sure that Courant's condition held throughout."""
    simulation = Simulation(job_of_dt(end / steps))
    for step in simulation:
        assert step.dt * simulation.kinetic.rate < 0.51, f"Courant number {step.dt * simulation.kinetic.rate}"
    assert simulation.number == steps
    return simulation


def coarsen(values: np.ndarray, cells: int) -> np.ndarray:
    """Means over equal groups of the first axis, `cells` of them."""
    return values.reshape(cells, -1, *values.shape[1:]).mean(axis=1)


def orders(errors: Any) -> np.ndarray:
    """Rates at which errors fall from one refinement by two to the next, along the first axis."""
    errors = np.asarray(errors)
    return np.log2(errors[:-1] / errors[1:])


def table(header: str, rows: list[tuple[Any, ...]]) -> None:
    """Print rows under a header of names, numbers to three digits."""
    names = header.split()
    texts = [[v if isinstance(v, str) else f"{v:d}" if isinstance(v, int) else f"{v:.3g}" for v in row] for row in rows]
    widths = [max(len(n), *(len(t[i]) for t in texts)) for i, n in enumerate(names)]
    for row in (names, *texts):
        print("  ".join(cell.rjust(width) for cell, width in zip(row, widths)), flush=True)
