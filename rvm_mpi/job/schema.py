"""The tables of a job file: their keys, types, ranges and defaults.

The descriptions of the fields are what messages call "allowed". A key whose default depends on other tables
is None until `rvm_mpi.job.checks.resolve` fills it in; its type is the one it has from then on.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    PlainValidator,
    PrivateAttr,
    Tag,
    field_validator,
    model_validator,
)

from rvm_mpi.job.section import (
    FOLLOWS,
    Fraction,
    NonNegative,
    Number,
    Positive,
    Section,
    Share,
    Switch,
    Vector,
)


def _kind_as_table(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


class Boundary(Section):
    """What happens at one side of the domain.

    After resolution: "diffuse" is "maxwell" with accommodation 1; a Maxwell wall has accommodation,
    temperature and velocity (one component per velocity dimension); a far field has density, temperature and
    velocity, or none of them when it is the initial state there; every other kind has none.
    """

    kind: Literal["periodic", "specular", "maxwell", "diffuse", "far-field", "outflow", "vacuum"] = Field(
        description='"periodic" | "specular" | "maxwell" | "diffuse" | "far-field" | "outflow" | "vacuum"'
    )
    accommodation: Fraction | None = Field(
        default=None, description="a number from 0 to 1, the fraction thermalised"
    )
    temperature: Positive | None = Field(default=None, description="a number > 0")
    density: Positive | None = Field(default=None, description="a number > 0")
    velocity: Vector | None = Field(default=None, description="a list of numbers, one per velocity dimension")


Side = Annotated[Boundary, BeforeValidator(_kind_as_table)]


def both_sides(value: Any) -> Any:
    """One kind for both sides is written without ``lower`` and ``upper``."""
    if isinstance(value, str) or (isinstance(value, Mapping) and "kind" in value):
        return {"lower": value, "upper": value}
    return value


class Sides(Section):
    """The two sides of one direction."""

    lower: Side = Field(description="a kind of boundary, or a table with `kind`")
    upper: Side = Field(description="a kind of boundary, or a table with `kind`")


Direction = Annotated[Sides, BeforeValidator(both_sides)]


class Boundaries(Section):
    """The sides of every direction; None where space has no such direction."""

    x: Direction | None = Field(default=None, description="a kind of boundary, or {lower = ..., upper = ...}")
    y: Direction | None = Field(default=None, description="a kind of boundary, or {lower = ..., upper = ...}")


class Space(Section):
    """The spatial grid: uniform cells over a box of 0, 1 or 2 dimensions."""

    cells: tuple[Annotated[int, Field(strict=True, ge=3, le=65536)], ...] = Field(
        description="a list of 0, 1 or 2 integers from 3 to 65536", max_length=2
    )
    lower: Vector = Field(default=FOLLOWS, description="a list of numbers, one per space dimension")
    upper: Vector = Field(default=FOLLOWS, description="a list of numbers, one per space dimension")
    boundary: Boundaries = Field(default=Boundaries(), description="a table with x, y")

    @property
    def dimensions(self) -> int:
        """Number of space dimensions, d_x."""
        return len(self.cells)

    @property
    def length(self) -> tuple[float, ...]:
        """Length of the domain along each direction."""
        return tuple(b - a for a, b in zip(self.lower, self.upper, strict=True))

    @property
    def spacing(self) -> tuple[float, ...]:
        """Width of a cell along each direction."""
        return tuple(length / n for length, n in zip(self.length, self.cells, strict=True))

    @property
    def sides(self) -> dict[str, Boundary]:
        """The boundaries by side: "x-lower", "x-upper", "y-lower", "y-upper", of the directions there are."""
        sides = {}
        for axis, both in zip("xy", (self.boundary.x, self.boundary.y), strict=True):
            if both is not None:
                sides[f"{axis}-lower"] = both.lower
                sides[f"{axis}-upper"] = both.upper
        return sides

    def periodic(self, axis: int) -> bool:
        """Whether direction 0 (x) or 1 (y) is periodic."""
        both = (self.boundary.x, self.boundary.y)[axis]
        return both is not None and both.lower.kind == "periodic"


class Velocity(Section):
    """The velocity grid: a box of 1, 2 or 3 dimensions, in xi (in v where nothing is rescaled)."""

    points: tuple[Annotated[int, Field(strict=True, ge=4, le=1024)], ...] = Field(
        description="a list of 1, 2 or 3 integers from 4 to 1024", min_length=1, max_length=3
    )
    half_width: tuple[Positive, ...] = Field(
        default=(7.0,), description="a number > 0, or a list of them, one per velocity dimension"
    )

    @model_validator(mode="before")
    @classmethod
    def _one_half_width_for_all(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("points"), list):
            width = data.get("half_width", 7.0)
            if not isinstance(width, list):
                return {**data, "half_width": [width] * len(data["points"])}
        return data

    @property
    def dimensions(self) -> int:
        """Number of velocity dimensions, d = d_v."""
        return len(self.points)

    @property
    def spacing(self) -> tuple[float, ...]:
        """Distance of neighbouring nodes along each direction."""
        return tuple(2 * width / n for width, n in zip(self.half_width, self.points, strict=True))


def _rate_or_auto(value: Any) -> Any:
    if value == "auto":
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError("wrong type")
    if not 0.0 <= value <= sys.float_info.max:
        raise ValueError("out of range")
    return float(value)


class Scaling(Section):
    """How velocity space is rescaled, v = omega xi, or v = u + omega xi in the thermal scaling."""

    kind: Literal["none", "macroscopic", "kinetic", "thermal"] = Field(
        default="kinetic", description='"none" | "macroscopic" | "kinetic" | "thermal"'
    )
    synchronise: Annotated[float | Literal["auto"], PlainValidator(_rate_or_auto)] = Field(
        default=0.0, description='a rate >= 0 or "auto", other than 0 with scaling.kind = "macroscopic" only'
    )


class OperatorFacts(NamedTuple):
    """What the rest of the program asks of a collision operator.

    Attributes
    ----------
    keys : tuple of str
        Those of `[collision]` that it uses beside its name.
    relaxes : bool
        Whether g relaxes to a Gaussian at a rate of its own, implicitly.
    explicit : bool
        Whether it gives a rate of g that is taken explicitly.
    dissipates : bool
        Whether it can take energy.
    """

    keys: tuple[str, ...]
    relaxes: bool
    explicit: bool
    dissipates: bool


#: by the name in the job file
OPERATORS = {
    "none": OperatorFacts((), relaxes=False, explicit=False, dissipates=False),
    "es-bgk": OperatorFacts(
        ("knudsen", "prandtl", "relaxation", "cross_section"), relaxes=True, explicit=False, dissipates=False
    ),
    "granular-es-bgk": OperatorFacts(
        ("knudsen", "restitution", "prandtl", "relaxation", "cross_section"),
        relaxes=True,
        explicit=False,
        dissipates=True,
    ),
    "boltzmann": OperatorFacts(
        ("knudsen", "restitution", "cross_section", "exponent", "method", "penalise", "coarse"),
        relaxes=False,
        explicit=True,
        dissipates=True,
    ),
}


class Relaxation(Section):
    """Relaxation rate tau(rho, T) = coefficient rho^density_power T^temperature_power."""

    coefficient: Positive = Field(description="a number > 0")
    density_power: Number = Field(default=1.0, ge=-4, le=4, description="a number from -4 to 4")
    temperature_power: Number = Field(default=0.5, ge=-4, le=4, description="a number from -4 to 4")


class Collision(Section):
    """The collision operator; a key the operator has no use for is None."""

    operator: Literal["none", "es-bgk", "granular-es-bgk", "boltzmann"] = Field(
        description='"none" | "es-bgk" | "granular-es-bgk" | "boltzmann"'
    )
    knudsen: Positive | None = Field(default=None, description="a number > 0")
    restitution: Fraction | None = Field(default=None, description="a number from 0 to 1")
    prandtl: Positive | None = Field(
        default=None, description="a number >= (d-1)/d in d velocity dimensions, 1 in one"
    )
    relaxation: Relaxation | None = Field(
        default=None, description="a table with coefficient, density_power, temperature_power"
    )
    cross_section: Positive | None = Field(default=None, description="a number > 0")
    exponent: Fraction | None = Field(
        default=None, description="a number from 0 (Maxwell molecules) to 1 (hard spheres)"
    )
    method: Literal["direct", "fast"] | None = Field(default=None, description='"direct" | "fast"')

    penalise: Switch | None = Field(
        default=None, description="true or false; true: steps not limited by the Knudsen number"
    )
    coarse: Switch | None = Field(
        default=None,
        description="true or false; true: a velocity grid on which viscosity or heat conduction is far off is wanted",
    )

    _cooling: float = PrivateAttr(0.0)

    @property
    def facts(self) -> OperatorFacts:
        """What is asked of the operator."""
        return OPERATORS[self.operator]

    @property
    def explicit(self) -> bool:
        """Whether the operator gives a rate of g that is taken explicitly."""
        return self.facts.explicit

    @property
    def elastic(self) -> bool:
        """Whether collisions keep energy."""
        return self.restitution is None or self.restitution == 1.0

    @property
    def cooling(self) -> float:
        """C/Knudsen number = (1 - e^2) k_d / (d Knudsen number); 0 where collisions keep energy.

        A homogeneous Maxwellian gas of hard spheres cools as dT/dt = -2 cooling rho T^(3/2), that is
        T(t) = T0 / (1 + cooling rho sqrt(T0) t)^2; a Boltzmann kernel |u|^exponent as T^(1 + exponent/2).
        """
        return self._cooling

    @property
    def nu(self) -> float:
        """ES-BGK's nu = 1 - 1/Pr; 0 where the operator has no Prandtl number."""
        return 0.0 if self.prandtl is None else 1.0 - 1.0 / self.prandtl


class Scheme(Section):
    """Discretisation."""

    drift: Literal["maxwellian", "van-leer", "seventh-order", "seventh-order-positive"] = Field(
        default="maxwellian",
        description='"maxwellian" | "van-leer" | "seventh-order" | "seventh-order-positive"',
    )
    conservative: Switch = Field(default=True, description="true | false")

    @field_validator("drift", mode="before")
    @classmethod
    def _name_what_replaces_kappa(cls, value: Any) -> Any:
        if value == "kappa":  # in jobs of earlier versions
            raise ValueError('the third order is no more: take "seventh-order", as fast and more accurate')
        return value


class Fluid(Section):
    """The macroscopic system beside the kinetic one; in a `Job` `enabled` is true or false."""

    enabled: Switch | None = Field(
        default=None, description='true | false; by default true with scaling.kind = "macroscopic" only'
    )


class Time(Section):
    """How far and in what steps; `cfl` is None where `dt` fixes the step."""

    end: Positive = Field(description="a number > 0")
    cfl: Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0, le=1)] | None = Field(
        default=None, description="a number > 0, at most 1"
    )
    max_steps: Annotated[int, Field(strict=True, ge=1, le=2**53)] | None = Field(
        default=None, description="an integer >= 1"
    )
    dt: Positive | None = Field(default=None, description="a number > 0, instead of cfl")


UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}


def duration(value: Any) -> float:
    """Seconds of a duration such as "10 min", "1 h 30 min", "30 s", "2 d"; ValueError otherwise."""
    if not isinstance(value, str):
        raise ValueError("wrong type")
    if not re.fullmatch(r"\s*((\d+(\.\d*)?([eE][-+]?\d+)?)\s*(s|min|h|d)\s*)+", value[:100]):
        raise ValueError("not a duration")
    parts = re.findall(r"(\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)\s*(s|min|h|d)", value[:100])
    seconds = sum(float(number) * UNITS[unit] for number, unit in parts)
    if not 0 < seconds < 1e10:
        raise ValueError("out of range")
    return seconds


MOST_SNAPSHOTS = 20_000
"""Snapshots of a run: all their times stand in `job.toml`, which is to stay below `text.LARGEST_FILE`."""


class SpacedTimes(Section):
    """Output times in few words: `count` of them, the first at `from` and the last at `to`."""

    start: NonNegative = Field(alias="from", description='a number >= 0, with spacing = "log" > 0')
    to: Positive = Field(description="a number above from, at most time.end")
    count: Annotated[int, Field(strict=True, ge=2, le=MOST_SNAPSHOTS)] = Field(
        description=f"an integer from 2 to {MOST_SNAPSHOTS}"
    )
    spacing: Literal["linear", "log"] = Field(default="linear", description='"linear" | "log"')


FORMS = ("(list)", "(table)")
"""How pydantic marks the forms of output.times in the place of an error."""


def _form_of_times(value: Any) -> str:
    return FORMS[1] if isinstance(value, (Mapping, SpacedTimes)) else FORMS[0]


if TYPE_CHECKING:
    Times = tuple[float, ...]  # what they are once resolved
else:
    Times = Annotated[
        Annotated[tuple[NonNegative, ...], Field(min_length=1), Tag(FORMS[0])] | Annotated[SpacedTimes, Tag(FORMS[1])],
        Discriminator(_form_of_times),
    ]


class Output(Section):
    """Snapshots at `times` (hit exactly) and checkpoints each `checkpoint_every` seconds of wall clock.

    After resolution `times` is the list of them all and `every` is None.
    """

    times: Times = Field(
        default=FOLLOWS,
        description="a list of rising numbers from 0 to time.end, "
        'or a table such as {from = 0.01, to = 100, count = 60, spacing = "log"}',
    )
    every: Positive | None = Field(
        default=None, description="a number > 0, at most time.end, instead of times: 0, every, 2 every, ... and the end"
    )
    checkpoint_every: Annotated[float, BeforeValidator(duration)] = Field(
        default=600.0, description='a duration in quotes such as "30 s", "10 min" or "1 h"'
    )
    marginals: Switch = Field(default=False, description="true | false")


class Watch(Section):
    """What a run says, or ends for, when it happens (`rvm_mpi/run/watch.py`)."""

    box_warning: Share = Field(
        default=1e-3, description="a number > 0, at most 1: share of a cell's mass or energy; 1: never"
    )
    box_stop: Share = Field(
        default=1.0, description="a number > 0, at most 1: share of a cell's mass or energy; 1: never"
    )
    balance: Positive = Field(default=1e-10, description="a number > 0, relative")
