"""What viscosity and heat conduction are worth on a velocity grid, over the exact ones, at unit temperature.

Read from `accuracy_tables.json`, measured and written by `python benchmarks/grid_accuracy.py --write`, where it says
what the figures are.
"""

import json
from importlib import resources

Row = tuple[float, ...]

_READ = json.loads(resources.files("rvm_mpi.advice").joinpath("accuracy_tables.json").read_text(encoding="utf-8"))

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
"""By reconstruction: conductivity with that spacing along the gradient, and across it."""
