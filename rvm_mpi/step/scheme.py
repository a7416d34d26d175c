"""The time integrator as data: what each stage of a step is made of.

With L transport and drift, z = dt tau/eps the relaxation depth of the step, and G[.] the Gaussian of a state, a stage
takes g, the result of the one before (g^n in the first), to

    whole(z) result = old g^n + new(z) (g + dt L(g)) + first(z) G[g^n] + last(z) G[result],

so each is a forward Euler step of the explicit part mixed with g^n, as strong stability preserving methods are
(Shu and Osher, J. Comput. Phys. 77, 1988), with an implicit relaxation. The weights are polynomials of z and add up:
old + new + first + last = whole, which keeps equilibria. The last result is g^(n+1).

Another integrator is another tuple of stages. What a table must obey: the explicit weights of its first stage do not
depend on z, which is known only after it; and with more than two stages a third copy of g is kept.
"""

from __future__ import annotations

from typing import NamedTuple

from rvm_mpi.compiling.declare import part

Polynomial = tuple[float, float, float]


class Stage(NamedTuple):
    """One stage; the polynomials are coefficients of 1, z, z^2.

    Attributes
    ----------
    number : int
        0 for the first, which finds the depth z.
    final : bool
        Whether its result is g^(n+1).
    old : float
        Weight of g^n, and of the moments carried at t^n.
    new, first, last, whole : tuple of three floats
        Weights as above.
    time : float
        Where in the step the state that it starts from lies, in parts of dt.
    cooled_before, cooled_after : float
        Shares of the step's cooling that are taken from the carried energy, of the state at t^n and of the stage's own
        result before cooling.
    reach : float
        Weight of the stage's result in g^(n+1), relaxation aside: the product of the later stages' 1 - old.
    """

    number: int
    final: bool
    old: float
    new: Polynomial
    first: Polynomial
    last: Polynomial
    whole: Polynomial
    time: float
    cooled_before: float
    cooled_after: float
    reach: float

    @property
    def share(self) -> float:
        """The part of the step's transport that this stage's rates make."""
        return self.reach * (1.0 - self.old)


class Weights(NamedTuple):
    """A stage's weights for one depth."""

    old: float
    new: float
    first: float
    last: float
    whole: float


#: one implicit-explicit Euler step: first order
EULER = (
    Stage(
        number=0,
        final=True,
        old=0.0,
        new=(1.0, 0.0, 0.0),
        first=(0.0, 0.0, 0.0),
        last=(0.0, 1.0, 0.0),
        whole=(1.0, 1.0, 0.0),
        time=0.0,
        cooled_before=0.0,
        cooled_after=1.0,
        reach=1.0,
    ),
)

#: Heun's method with a relaxation that is exact to second order and tends to G as z grows: with G fixed and L = 0,
#: g^(n+1) - G = (g^n - G)/(1 + z + z^2/2)
HEUN = (
    EULER[0]._replace(final=False, reach=0.5),
    Stage(
        number=1,
        final=True,
        old=0.5,
        new=(0.5, 0.5, 0.0),
        first=(0.0, 0.5, 0.0),
        last=(0.0, 0.0, 0.5),
        whole=(1.0, 1.0, 0.5),
        time=1.0,
        cooled_before=0.5,
        cooled_after=0.0,
        reach=1.0,
    ),
)


@part
def at_depth(polynomial, z):  # type: ignore[no-untyped-def]
    """c0 + c1 z + c2 z^2."""
    return polynomial[0] + z * (polynomial[1] + z * polynomial[2])


@part
def weights(stage, z):  # type: ignore[no-untyped-def]
    """A stage's weights for the depth z."""
    return Weights(
        stage.old, at_depth(stage.new, z), at_depth(stage.first, z), at_depth(stage.last, z), at_depth(stage.whole, z)
    )
