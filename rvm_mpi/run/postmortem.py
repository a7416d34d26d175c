"""What is left of a run that failed: one JSON file, small enough to mail, that says where and in which state.

`post-mortem.json` holds the job, the versions, the failing cell and its neighbours as the last stage found and left
them, the marginals of g there (g itself where the velocity grid is small), and the last rows of the history. Numbers
that JSON has not are the words "nan", "inf" and "-inf".
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi.output.disk import free_name
from rvm_mpi.step.failure import PROBLEMS

if TYPE_CHECKING:
    from rvm_mpi.simulation import Simulation
    from rvm_mpi.step.failure import NumericalFailure

FILE = "post-mortem.json"
#: nodes of a velocity grid up to which g of the failing cell is kept: the file stays far below 1 MB
MOST_NODES = 10_000
#: rows of the history that are kept
ROWS = 20


def examine(simulation: Simulation, failure: NumericalFailure) -> dict[str, Any]:
    """What is known about a failed step; collective. Complete on rank 0.

    Parameters
    ----------
    simulation : Simulation
        As the failure left it.
    failure : NumericalFailure
        Raised by it on every rank.

    Returns
    -------
    dict
        what, step (that failed), time and dt (at and with which it began), where, last_step, and of the cell, where
        there is one: its neighbourhood, marginals and g.
    """
    sim = simulation
    found: dict[str, Any] = {
        "what": str(failure),
        "step": sim.number + 1,
        "time": sim.time,
        "dt": failure.dt,
        "stage": sim.kinetic.last.stage.number + 1,
        "last_step": dict(sim.diagnostics.row),
        "job": sim.job.to_toml(),
    }
    if failure.cell is None:
        return found
    found["where"] = {
        "cell": failure.cell,
        "position": sim.domain.centre(failure.cell),
        "rank": sim.domain.owner(failure.cell),
        "ranks": sim.domain.size,
        "velocity_node": failure.node,
    }
    mine = {cell: _cell(sim, cell) for cell in _neighbourhood(sim, failure.cell) if _is_here(sim, cell)}
    blocks = _velocities(sim, failure.cell) if failure.cell in mine else {}
    for cells, velocities in sim.domain.comm.gather((mine, blocks)) or []:
        found.setdefault("cells", []).extend(cells.values())
        found.update(velocities)
    return found


def _neighbourhood(sim: Simulation, cell: tuple[int, int]) -> list[tuple[int, int]]:
    """The cell and those around it, across periodic sides too."""
    around: dict[tuple[int, int], None] = {}
    for dj in (-1, 0, 1):
        for di in (-1, 0, 1):
            place = []
            for k, n, axis in zip((cell[0] + di, cell[1] + dj), sim.domain.cells, (0, 1)):
                wraps = axis < sim.domain.dimensions and sim.job.space.periodic(axis)
                place.append(k % n if wraps else k)
            if all(0 <= k < n for k, n in zip(place, sim.domain.cells)):
                around[place[0], place[1]] = None
    return list(around)


def _is_here(sim: Simulation, cell: tuple[int, int]) -> bool:
    return all(0 <= k - first < n for k, first, n in zip(cell, sim.domain.start, sim.domain.local))


def _cell(sim: Simulation, cell: tuple[int, int]) -> dict[str, Any]:
    """What is known of one of this rank's cells: `start` is what the step began with, `stage` what the last stage read.

    `result` is what it wrote, as far as it came; `sums` are those of 1, xi, xi xi times g over the nodes.
    """
    kinetic, units = sim.kinetic, sim.kinetic.units
    i, j = cell[0] - sim.domain.start[0], cell[1] - sim.domain.start[1]
    found: dict[str, Any] = {
        "cell": cell,
        "position": sim.domain.centre(cell),
        "rank": sim.domain.rank,
        "status": PROBLEMS.get(int(kinetic.report["status"][j, i]), "healthy"),
        "transport_rate": float(kinetic.report["transport"][j, i]),
        "drift_rate": float(kinetic.report["drift"][j, i]),
        "cooling_rate": float(kinetic.report["cooling_rate"][j, i]),
    }
    speed, volume = units.velocity, kinetic.grid.weight / units.g
    xi = np.array([1.0, *[speed] * 3, *[speed * speed] * 6])
    for name, cells in (("start", kinetic.now), ("stage", kinetic.last.begin), ("result", kinetic.last.new)):
        omega, sums = float(kinetic.inside(cells.omega)[j, i]) / speed, cells.sums[j, i] * units.g * xi
        frame = omega, kinetic.inside(cells.mean)[j, i]
        found[name] = {"omega": omega, "sums": sums, **_moments(sums, frame, kinetic.grid.dimensions, volume)}
        if kinetic.model.carried:
            found[name]["carried"] = cells.carried[j, i]
    if sim.fluid is not None:
        found["fluid"] = sim.fluid.interior[j, i]
    return found


def _moments(sums: np.ndarray, frame: tuple[float, np.ndarray], d: int, weight: float) -> dict[str, Any]:
    """Density, velocity and temperature of f from the sums of g over the nodes."""
    omega, counted_from = frame
    with np.errstate(all="ignore"):
        mean = sums[1 : 1 + d] / sums[0]
        temperature = omega**2 * ((sums[4] + sums[7] + sums[9]) / sums[0] - np.sum(mean**2)) / d
    return {"density": weight * sums[0], "velocity": counted_from[:d] + omega * mean, "temperature": temperature}


def _velocities(sim: Simulation, cell: tuple[int, int]) -> dict[str, Any]:
    """Marginals of g of one of this rank's cells along each axis in use, and g itself if it is small."""
    kinetic, grid, units = sim.kinetic, sim.kinetic.velocity_grid, sim.kinetic.units
    i, j = cell[0] - sim.domain.start[0], cell[1] - sim.domain.start[1]
    blocks = {
        name: grid.unpack(kinetic.inside(g)[j, i]) * units.g
        for name, g in (("stage", kinetic.last.g), ("result", kinetic.last.out))
    }
    marginals = {}
    for name, block in blocks.items():
        for q in range(grid.dimensions):
            others = tuple(axis for axis in range(3) if axis != q)
            across = grid.weight / units.g / (grid.spacing[q] * units.velocity)
            marginals[f"{name}_{'xyz'[q]}"] = block.sum(axis=others) * across
    found: dict[str, Any] = {"marginals": marginals}
    if math.prod(grid.points) <= MOST_NODES:
        shape = grid.points[: grid.dimensions]
        found["g"] = {name: block.reshape(shape) for name, block in blocks.items()}
    return found


def write(directory: Path, found: dict[str, Any], more: dict[str, Any]) -> Path:
    """Write the file; for rank 0. One that is there from an earlier failure is kept as `post-mortem-1.json`.

    Parameters
    ----------
    directory : Path
        The run directory.
    found : dict
        From `examine`.
    more : dict
        What the run knows beside it: versions, last checkpoint, history.
    """
    path = directory / FILE
    if path.exists():
        path.rename(free_name(directory / "post-mortem", ".json"))
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(_plain({**found, **more}), allow_nan=False), encoding="utf-8")
    part.replace(path)
    return path


def _plain(value: Any) -> Any:
    """In JSON's types."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else repr(float(value))
    return value
