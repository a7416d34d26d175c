"""What viscosity, heat conduction and the cooling state are worth on a velocity grid, at unit temperature.

Read from `accuracy_tables.json`, measured and written by `python benchmarks/grid_accuracy.py --write`, where it says
what the figures are.
"""

import json
from importlib import resources
from math import nan

Row = tuple[float, ...]

_READ = json.loads(resources.files("rvm_mpi.advice").joinpath("accuracy_tables.json").read_text(encoding="utf-8"))


def _rows(rows: list[list[float | None]]) -> tuple[Row, ...]:
    """Null, where there is no number, as one that is not."""
    return tuple(tuple(nan if value is None else value for value in row) for row in rows)


HALF_WIDTHS: dict[int, Row] = {int(d): tuple(row) for d, row in _READ["half_widths"].items()}
"""Half widths of the Boltzmann tables by dimensions."""
BOLTZMANN: dict[int, dict[int, tuple[Row, ...]]] = {
    int(d): {int(points): tuple(map(tuple, rows)) for points, rows in table.items()}
    for d, table in _READ["boltzmann"].items()
}
"""By dimensions and points a direction: viscosity (d = 1: loss of energy), conductivity, residue (d > 1)."""
SPACINGS: Row = tuple(_READ["spacings"])
"""Spacings of the table of the drift."""
DRIFT: dict[str, tuple[Row, ...]] = {name: tuple(map(tuple, rows)) for name, rows in _READ["drift"].items()}
"""By reconstruction: conductivity with that spacing along the gradient and across it, and viscosity."""
COOLING_HALF_WIDTHS: dict[int, Row] = {int(d): tuple(row) for d, row in _READ["cooling_half_widths"].items()}
"""Half widths of the table of cooling states by dimensions."""
COOLING_RESTITUTIONS: dict[int, Row] = {int(d): tuple(row) for d, row in _READ["cooling_restitutions"].items()}
"""Restitution coefficients of that table, rising."""
COOLING: dict[int, dict[str, dict[int, tuple[Row, ...]]]] = {
    int(d): {drift: {int(points): _rows(rows) for points, rows in table.items()} for drift, table in drifts.items()}
    for d, drifts in _READ["cooling"].items()
}
"""By dimensions, reconstruction and points a direction: a_2 less the exact one, a row for each restitution
coefficient; not a number where the run failed."""
EXACT_A2: dict[int, tuple[tuple[float, float], ...]] = {
    int(d): tuple(map(tuple, pairs)) for d, pairs in _READ["exact_a2"].items()
}
"""By dimensions: restitution coefficients and a_2 of the cooling state by Sonine theory."""
