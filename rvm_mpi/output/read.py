"""The results of a run, read back: for plots, scripts and other programs. Needs no MPI."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi.output.hdf5 import datasets, open_alone
from rvm_mpi.output.history import HISTORY
from rvm_mpi.output.layout import AXES, FIELDS

if TYPE_CHECKING:
    import xarray


def open_run(directory: str | Path) -> xarray.Dataset:
    """The snapshots of a run, finished or not, in memory. Needs no MPI.

    Parameters
    ----------
    directory : the run directory, or its `fields.h5`

    Returns
    -------
    xarray.Dataset : every dataset of `fields.h5` under its name with underscores (`kinetic/density` is
        `kinetic_density`), with the times that exist, dimensions time, y, x and component, and the attributes
        of the file.

    Raises
    ------
    FileNotFoundError : there is no `fields.h5`.
    """
    import xarray

    path = Path(directory)
    if path.is_dir():
        path = path / FIELDS
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; is {path.parent} a run directory?")
    with open_alone(path, "r") as file:
        time = file["time"][()]
        exists = np.flatnonzero(np.isfinite(time))
        coordinates: dict[str, Any] = {}
        variables: dict[str, Any] = {}
        for name, dataset in datasets(file):
            attributes = dict(dataset.attrs)
            axes = attributes.pop("axes").split()
            values = dataset[exists] if axes[0] == "time" and len(exists) else dataset[()]
            if axes[0] == "time" and not len(exists):
                values = values[:0]
            if axes == [name.split("/")[-1]]:
                coordinates[axes[0]] = (axes, values, attributes)
            else:
                attributes["path"] = f"/{name}"
                variables[name.replace("/", "_").replace("-", "_")] = (axes, values, attributes)
        for axis in ("component", "other_component"):
            lengths = [np.shape(v[1])[v[0].index(axis)] for v in variables.values() if axis in v[0]]
            coordinates[axis] = list(AXES[: lengths[0]])
        return xarray.Dataset(variables, coordinates, dict(file.attrs))


def read_history(directory: str | Path) -> dict[str, np.ndarray]:
    """The columns of `history.csv`, each an array with an entry per row; a last row cut off is ignored.

    Raises
    ------
    FileNotFoundError : there is none.
    """
    path = Path(directory)
    if path.is_dir():
        path = path / HISTORY
    text = path.read_text(encoding="ascii")
    rows = list(csv.reader(text[: text.rfind("\n") + 1].splitlines()))
    table = np.array(rows[1:], dtype=np.float64).reshape(-1, len(rows[0]))
    return dict(zip(rows[0], table.T, strict=True))
