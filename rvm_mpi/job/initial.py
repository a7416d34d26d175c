"""The initial states of a job file: the table `[initial]` is one of these, by its key `state`."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

from pydantic import Field

from rvm_mpi.job.section import FOLLOWS, NonNegative, Number, Positive, Section, Text, Vector

LARGEST_SEED = 2**63 - 1


class Uniform(Section):
    """The same state everywhere; `stress`, a temperature tensor, makes it an anisotropic Gaussian."""

    state: Literal["uniform"]
    density: Positive = Field(default=1.0, description="a number > 0")
    temperature: Positive = Field(default=FOLLOWS, description="a number > 0")
    velocity: Vector = Field(default=FOLLOWS, description="a list of numbers, one per velocity dimension")
    stress: tuple[Vector, ...] | None = Field(
        default=None, description="a symmetric positive definite d x d list of lists of numbers"
    )


class RandomDensity(Section):
    """Density uniformly distributed over (low, high), gas at rest."""

    state: Literal["random-density"]
    seed: Annotated[int, Field(strict=True, ge=0, le=LARGEST_SEED)] = Field(
        default=0, description="an integer >= 0"
    )
    low: NonNegative = Field(default=0.0, description="a number >= 0, below high")
    high: Positive = Field(default=1.0, description="a number > low")
    temperature: Positive = Field(default=1.0, description="a number > 0")
    correlation_length: NonNegative = Field(
        default=0.0,
        description="0 (white noise per cell), or a length from 1/350 of the domain to all of it",
    )


class TemperatureDisc(Section):
    """Temperature `inner` within a disc (in one dimension a slab), `outer` around it, gas at rest."""

    state: Literal["temperature-disc"]
    radius: Positive = Field(default=0.5, description="a number > 0")
    inner: Positive = Field(default=1.0, description="a number > 0")
    outer: Positive = Field(default=100.0, description="a number > 0")
    density: Positive = Field(default=1.0, description="a number > 0")
    centre: Vector = Field(
        default=FOLLOWS, description="a point inside the domain, one number per space dimension"
    )


class GasState(Section):
    """The state on one side of a Riemann problem."""

    density: Positive = Field(description="a number > 0")
    temperature: Positive = Field(description="a number > 0")
    velocity: Vector = Field(default=FOLLOWS, description="a list of numbers, one per velocity dimension")


class Riemann(Section):
    """Two uniform states that meet at `position` along `direction`."""

    state: Literal["riemann"]
    direction: Literal["x", "y"] = Field(default="x", description='"x" | "y", a direction space has')
    position: Number = Field(default=FOLLOWS, description="a number inside the domain")
    left: GasState = Field(description="a table with density, temperature, velocity")
    right: GasState = Field(description="a table with density, temperature, velocity")


class Wave(Section):
    """Each field is base + amplitude cos(2 pi mode . (x - lower)/length)."""

    state: Literal["wave"]
    density: Positive = Field(default=1.0, description="a number > 0")
    temperature: Positive = Field(default=1.0, description="a number > 0")
    velocity: Vector = Field(default=FOLLOWS, description="a list of numbers, one per velocity dimension")
    mode: Vector = Field(
        default=FOLLOWS, description="a list of whole numbers (halves between walls), one per space dimension"
    )
    density_amplitude: Number = Field(default=0.0, description="a number between -density and density")
    temperature_amplitude: Number = Field(
        default=0.0, description="a number between -temperature and temperature"
    )
    velocity_amplitude: Vector = Field(
        default=FOLLOWS, description="a list of numbers, one per velocity dimension"
    )


class FromRun(Section):
    """Density, velocity and temperature of the kinetic fields of another run, on this job's grid."""

    state: Literal["from-run"]
    run: Text = Field(description="the directory of a run")
    time: NonNegative | None = Field(
        default=None, description="the time of a snapshot there; the last one when not given"
    )


class TwoGaussians(Section):
    """Two Gaussians of variance sigma^2 at +-sigma (1, .., 1); not a Maxwellian."""

    state: Literal["two-gaussians"]
    sigma: Positive = Field(default=0.5**0.5, description="a number > 0")


class Bkw(Section):
    """The exact solution for Maxwell molecules (Bobylev, Krook and Wu) at time 0; not a Maxwellian."""

    state: Literal["bkw"]


Initial = Annotated[
    Uniform | RandomDensity | TemperatureDisc | Riemann | Wave | FromRun | TwoGaussians | Bkw,
    Field(discriminator="state"),
]
INITIAL_STATES: dict[str, type[Section]] = {
    get_args(model.model_fields["state"].annotation)[0]: model for model in get_args(get_args(Initial)[0])
}
