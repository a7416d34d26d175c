"""Checks and defaults of `[collision]`, some of which follow from the number d of velocity dimensions."""

from __future__ import annotations

from math import isfinite

from rvm_mpi import kinetic_theory
from rvm_mpi.job.schema import Collision, Relaxation
from rvm_mpi.job.text import KeyProblem
from rvm_mpi.job.updates import updated

ROUNDED = 2e-4
"""Relative distance at which a Prandtl number just below its bound counts as that bound, rounded (0.6666)."""


def resolve_collision(given: Collision, d: int) -> Collision:
    """The collision operator with every key that it uses; KeyProblem for one that it does not."""
    operator = given.operator
    facts = given.facts
    used = facts.keys
    for name in Collision.model_fields:
        value = getattr(given, name)
        if name == "operator" or value is None or name in used:
            continue
        if name == "restitution" and value == 1.0:
            continue
        hint = "granular-es-bgk" if name == "restitution" and facts.relaxes else ""
        raise KeyProblem(
            f"collision.{name}", f'not used by "{operator}"', value, ", ".join(("operator", *used)), hint
        )
    for name in ("knudsen", "restitution"):
        if name in used and getattr(given, name) is None:
            raise KeyProblem(
                f"collision.{name}", "must be given", allowed=Collision.model_fields[name].description or ""
            )
    if not used:
        return Collision(operator=operator)
    cross_section = given.cross_section or (0.25 if d == 3 else 1.0)
    if facts.explicit:
        exponent = 1.0 if given.exponent is None else given.exponent
        resolved = updated(
            given, cross_section=cross_section, exponent=exponent, method=given.method or "direct",
            penalise=bool(given.penalise), coarse=bool(given.coarse),
        )
    else:
        exponent = 1.0
        resolved = _resolve_relaxation(given, cross_section, d)
    if not facts.dissipates:
        resolved = updated(resolved, restitution=None, cross_section=None)
    if not resolved.elastic:
        assert resolved.knudsen is not None and resolved.restitution is not None
        k_d = kinetic_theory.dissipation_coefficient(d, cross_section, exponent)
        resolved._cooling = (1.0 - resolved.restitution**2) * k_d / d / resolved.knudsen
        if not isfinite(resolved._cooling):
            raise KeyProblem("collision.knudsen", "too small: the cooling rate overflows", given.knudsen)
    return resolved


def _resolve_relaxation(given: Collision, cross_section: float, d: int) -> Collision:
    """Prandtl number and relaxation rate of the ES-BGK family; by default the hard spheres' own."""
    prandtl = _prandtl(given.prandtl, d)
    relaxation = given.relaxation
    if relaxation is not None and given.cross_section is not None and not given.facts.dissipates:
        raise KeyProblem(
            "collision.cross_section",
            f'not used by "{given.operator}" beside collision.relaxation',
            given.cross_section,
            "one of the two",
        )
    if relaxation is None:
        if d == 1:
            raise KeyProblem(
                "collision.relaxation",
                "must be given in one velocity dimension: no viscosity fixes it",
                allowed="a table such as {coefficient = 1.0, density_power = 1, temperature_power = 0.5}",
            )
        relaxation = Relaxation(coefficient=kinetic_theory.hard_sphere_relaxation(d, cross_section, prandtl))
    assert given.knudsen is not None
    if not isfinite(relaxation.coefficient / given.knudsen):
        raise KeyProblem("collision.knudsen", "too small: the relaxation rate overflows", given.knudsen)
    return updated(given, prandtl=prandtl, relaxation=relaxation, cross_section=cross_section)


def _prandtl(given: float | None, d: int) -> float:
    """The Prandtl number; nu = 1 - 1/Pr >= -1/(d-1), or the Gaussian does not exist."""
    smallest = (d - 1) / d if d > 1 else 1.0
    if given is None:
        return smallest
    if smallest * (1 - ROUNDED) <= given < smallest:
        return smallest
    if given < smallest or (d == 1 and given != 1.0):
        allowed = (
            "1 in one velocity dimension" if d == 1 else f"at least {d - 1}/{d} in {d} velocity dimensions"
        )
        raise KeyProblem("collision.prandtl", "no Gaussian with this Prandtl number exists", given, allowed)
    return given
