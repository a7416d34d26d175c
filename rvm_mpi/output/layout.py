"""What `fields.h5` holds: its datasets, their shapes and what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

FIELDS = "fields.h5"
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Layout:
    """One dataset of `fields.h5`, as it is in each snapshot (the axis of times comes in front of these).

    Attributes
    ----------
    shape : lengths of the axes; () for one number per snapshot
    axes : their names, such as ("y", "x", "component")
    long_name, units : attributes of the dataset
    """

    shape: tuple[int, ...]
    axes: tuple[str, ...]
    long_name: str
    units: str = "1"


def stores_fluid(job: Job) -> bool:
    """Whether a run of this job stores the macroscopic system's own solution under `/fluid`."""
    return bool(job.fluid.enabled or job.scaling.kind == "macroscopic")


def field_layout(job: Job) -> dict[str, Layout]:
    """The cell fields that every run of `job` stores, by dataset name, in their order in the file."""
    space = tuple(reversed(job.space.cells))
    axes = ("x",) if len(space) == 1 else ("y", "x")[: len(space)]
    d = job.velocity.dimensions

    def density(of: str) -> Layout:
        return Layout(space, axes, f"density of {of}", "reference density")

    def temperature(of: str) -> Layout:
        return Layout(space, axes, f"temperature of {of}", "reference temperature")

    def velocity(of: str) -> Layout:
        return Layout((*space, d), (*axes, "component"), f"mean velocity of {of}", "reference speed")

    f = "the distribution function f"
    layout = {
        "kinetic/density": density(f),
        "kinetic/temperature": temperature(f),
        "kinetic/velocity": velocity(f),
        "kinetic/heat_flux": Layout(
            (*space, d),
            (*axes, "component"),
            "heat flux: 1/2 of the integral of c |c|^2 f over v, c = v - velocity",
            "reference density x speed^3",
        ),
        "kinetic/stress": Layout(
            (*space, d, d),
            (*axes, "component", "other_component"),
            "temperature tensor Theta: the integral of c c^T f over v, divided by the density; "
            "its trace is d times the temperature",
            "reference temperature",
        ),
        "kinetic/pressure_tensor": Layout(
            (*space, d, d),
            (*axes, "component", "other_component"),
            "pressure tensor: the integral of c c^T f over v, density times kinetic/stress; its trace is d times the "
            "pressure",
            "reference pressure",
        ),
        "scaling/omega": Layout(space, axes, "scaling of velocity: v = omega xi", "reference speed"),
    }
    if stores_fluid(job):
        fluid = "the macroscopic system"
        layout["fluid/density"] = density(fluid)
        layout["fluid/temperature"] = temperature(fluid)
        layout["fluid/velocity"] = velocity(fluid)
    if job.output.marginals:
        layout["marginal/x"] = Layout(
            (*space, job.velocity.points[0]),
            (*axes, "xi_x"),
            "first marginal of g: the integral of g over all velocity components but xi_x",
            "reference density",
        )
    return layout


def wall_layout(job: Job) -> dict[str, Layout]:
    """The datasets of each wall of `job`: one number or vector for each of its n faces, in the order of the cells."""
    nx, ny = (*job.space.cells, 1, 1)[:2]
    layout = {}
    for name, side in job.space.sides.items():
        if side.kind not in ("maxwell", "specular"):
            continue
        n, axis = (ny, "y") if name[0] == "x" else (nx, "x")
        shape, axes = ((n,), (axis,)) if job.space.dimensions == 2 else ((1,), ("face",))
        what = f"the wall at {name}, mean over the last step"
        layout[f"wall/{name}/pressure"] = Layout(
            shape, axes, f"pressure: force per area along the outer normal on {what}", "reference pressure"
        )
        layout[f"wall/{name}/shear_stress"] = Layout(
            (*shape, job.velocity.dimensions),
            (*axes, "component"),
            f"shear stress: force per area along the wall on {what}",
            "reference pressure",
        )
        layout[f"wall/{name}/heat_flux"] = Layout(
            shape,
            axes,
            f"heat per area and time, in the wall's own frame, positive into {what}",
            "reference pressure x speed",
        )
        layout[f"wall/{name}/work"] = Layout(
            shape,
            axes,
            "work per area and time that the gas does, shear stress . velocity of the wall, positive where "
            f"the gas drives it, on {what}; heat_flux + work is the energy that leaves the gas",
            "reference pressure x speed",
        )
    return layout


def coordinates_of(job: Job, xi_x: np.ndarray | None) -> dict[str, np.ndarray]:
    """Cell centres in space and, where marginals are stored, in xi_x."""
    coordinates = {
        axis: lower + (np.arange(n) + 0.5) * h
        for axis, n, lower, h in zip(AXES, job.space.cells, job.space.lower, job.space.spacing, strict=False)
    }
    if job.output.marginals:
        n, half_width = job.velocity.points[0], job.velocity.half_width[0]
        centres = -half_width + (np.arange(n) + 0.5) * (2 * half_width / n)
        coordinates["marginal/xi_x"] = centres if xi_x is None else np.asarray(xi_x, dtype=np.float64)
    return coordinates
