"""`fields.xdmf`: what tells ParaView and VisIt how to read `fields.h5`."""

from __future__ import annotations

import contextlib
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rvm_mpi.output.disk import named
from rvm_mpi.output.layout import AXES, FIELDS, Layout, field_layout

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job


class Xdmf:
    """`fields.xdmf`: describes `fields.h5`, beside it, to ParaView and VisIt. For rank 0.

    XDMF version 2, cell data, rectangular mesh. One row of cells stands for one space dimension, one cell for none.
    With three velocity dimensions velocity and heat flux are vectors and the stress is a tensor; with fewer, their
    components are scalars. Marginals and walls are not described.

    A new snapshot is written over the file's last lines, which follow it again: what it costs does not grow with the
    number of those before.

    Parameters
    ----------
    path : the file
    job : Job
    stored : times of the snapshots in the order of `fields.h5`, NaN for those that are not there; if there are any,
        the file is written
    """

    HEAD = (
        "<?xml version='1.0' encoding='utf-8'?>\n"
        '<Xdmf Version="2.2">\n  <Domain>\n'
        '    <Grid Name="rvm_mpi" GridType="Collection" CollectionType="Temporal">\n'
    )
    TAIL = "    </Grid>\n  </Domain>\n</Xdmf>\n"

    def __init__(self, path: str | Path, job: Job, stored: Sequence[float] | np.ndarray) -> None:
        self._path, self._job = Path(path), job
        self._times = [float(time) for time in stored]
        self._size = -1
        self._form = self._grid_form()
        if np.isfinite(self._times).any():
            self._write()

    def add(self, index: int, time: float) -> None:
        """Describe one more snapshot.

        Parameters
        ----------
        index : its place in `fields.h5`
        time : its time

        Raises
        ------
        OSError : it cannot be written; the file is then as it was.
        """
        if self._times[index] == time:
            return
        last = not np.isfinite(self._times[index:]).any()
        self._times[index] = time
        if last and self._size == self._size_there():
            self._append(index)
        else:
            self._write()

    def _size_there(self) -> int:
        try:
            return self._path.stat().st_size
        except FileNotFoundError:
            return -2

    def _write(self) -> None:
        """The whole file, replaced in one step."""
        part = self._path.with_name(self._path.name + ".part")
        with named(self._path):
            with part.open("w", encoding="utf-8") as file:
                file.write(self.HEAD)
                file.writelines(self._grid(index) for index, time in enumerate(self._times) if np.isfinite(time))
                file.write(self.TAIL)
            part.replace(self._path)
        self._size = self._size_there()

    def _append(self, index: int) -> None:
        begin = self._size - len(self.TAIL)
        text = (self._grid(index) + self.TAIL).encode()
        with named(self._path), self._path.open("r+b", buffering=0) as file:
            try:
                file.seek(begin)
                while text:
                    text = text[file.write(text) :]
                self._size = file.tell()
            except OSError:
                with contextlib.suppress(OSError):
                    file.seek(begin)
                    file.write(self.TAIL.encode())
                    file.truncate(self._size)
                self._times[index] = float("nan")
                raise

    def _grid(self, index: int) -> str:
        """The lines on one snapshot."""
        return self._form.replace("TIME", repr(self._times[index])).replace("INDEX", str(index))

    def _grid_form(self) -> str:
        """The same with words for what differs from one to the next: to make them costs more than to write them."""
        job = self._job
        nx, ny = (*job.space.cells, 1, 1)[:2]
        lower = (*job.space.lower, 0.0, 0.0)[:2]
        spacing = (*job.space.spacing, 1.0, 1.0)[:2]
        if job.space.dimensions == 1:
            spacing = (spacing[0], spacing[0])
        number: dict[str, Any] = {"NumberType": "Float", "Precision": "8"}
        grid = ET.Element("Grid", Name="snapshot INDEX", GridType="Uniform")
        ET.SubElement(grid, "Time", Value="TIME")
        # not 2DCoRectMesh: VTK's reader takes its axes for y and z
        ET.SubElement(grid, "Topology", TopologyType="2DRectMesh", Dimensions=f"{ny + 1} {nx + 1}")
        geometry = ET.SubElement(grid, "Geometry", GeometryType="VXVY")
        for n, first, h in ((nx, lower[0], spacing[0]), (ny, lower[1], spacing[1])):
            item = ET.SubElement(geometry, "DataItem", Dimensions=f"{n + 1}", **number, Format="XML")
            item.text = " ".join(repr(first + i * h) for i in range(n + 1))
        for name, layout in field_layout(job).items():
            if name != "marginal/x":
                _xdmf_field(grid, name, layout, len(self._times), (ny, nx), job.space.dimensions)
        ET.indent(grid, level=3)
        return f"      {ET.tostring(grid, encoding='unicode')}\n"


def _xdmf_field(
    grid: ET.Element,
    name: str,
    layout: Layout,
    snapshots: int,
    cells: tuple[int, int],
    dimensions: int,
):
    """Add a field of one snapshot: whole if a scalar or of three components, else component by component."""
    title = name.replace("/", " ").replace("_", " ")
    space, components = layout.shape[:dimensions], layout.shape[dimensions:]
    kind = {(): "Scalar", (3,): "Vector", (3, 3): "Tensor"}.get(components)
    size = f"{cells[0]} {cells[1]}"
    whole = (snapshots, *layout.shape)
    if kind:
        attribute = ET.SubElement(grid, "Attribute", Name=title, AttributeType=kind, Center="Cell")
        entries = f" {int(np.prod(components))}" if components else ""
        start = ("INDEX", *(0 for _ in layout.shape))
        _xdmf_slab(attribute, name, size + entries, whole, start, (1, *layout.shape))
        return
    for component in np.ndindex(*components):
        if list(component) != sorted(component):  # a tensor here is symmetric
            continue
        label = "".join(AXES[k] for k in component)
        attribute = ET.SubElement(
            grid, "Attribute", Name=f"{title} {label}", AttributeType="Scalar", Center="Cell"
        )
        start = ("INDEX", *(0 for _ in space), *component)
        _xdmf_slab(attribute, name, size, whole, start, (1, *space, *(1 for _ in component)))


def _xdmf_slab(
    attribute: ET.Element,
    name: str,
    size: str,
    whole: tuple[int, ...],
    start: tuple[object, ...],
    count: tuple[int, ...],
):
    """Add the part of a dataset that begins at `start` and has the shape `count`, seen as of shape `size`."""
    number: dict[str, Any] = {"NumberType": "Float", "Precision": "8"}
    slab = ET.SubElement(attribute, "DataItem", ItemType="HyperSlab", Dimensions=size, **number, Format="HDF")
    choice = ET.SubElement(slab, "DataItem", Dimensions=f"3 {len(whole)}", NumberType="Int", Format="XML")
    choice.text = " ".join(map(str, (*start, *(1 for _ in whole), *count)))
    data = ET.SubElement(slab, "DataItem", Dimensions=" ".join(map(str, whole)), **number, Format="HDF")
    data.text = f"{FIELDS}:/{name}"
