"""The implicit part of a stage: the moments wanted, the correction to them, and the Gaussian that g relaxes to."""

from __future__ import annotations

from rvm_mpi.compiling.declare import part
from rvm_mpi.compiling.simd import fma, load, store
from rvm_mpi.kinetic.conservation import add_correction, correct, no_factor, weighted_sums
from rvm_mpi.kinetic.gaussian import discrete_gaussian, discrete_maxwellian
from rvm_mpi.kinetic.realisable import EXACT, REPLACED
from rvm_mpi.units import power as plain_power

#: greatest depth dt tau/eps of a relaxation. A deeper one differs from the limit eps -> 0 by less than 1/DEEPEST, but 1
#: beside its square is lost to rounding, and the explicit part with it
DEEPEST = 1e12

power = part(plain_power)


@part
def relaxation_rate(model, density, temperature):  # type: ignore[no-untyped-def]
    """tau(rho, T)/eps of f."""
    return model.relaxation * power(density, model.density_power) * power(temperature, model.temperature_power)


@part
def mean_depth(model, dt, before, after):  # type: ignore[no-untyped-def]
    """dt tau/eps, tau the mean of those of two states (density, temperature); at most DEEPEST."""
    rate = relaxation_rate(model, before[0], before[1]) + relaxation_rate(model, after[0], after[1])
    z = 0.5 * dt * rate
    return DEEPEST if z > DEEPEST else z


@part
def blend(nu, d, first, sums, weights, wanted, temperature, gaussian):  # type: ignore[no-untyped-def]
    """Mean and temperature tensor of first G[g^n] + last G[result], as one Gaussian; returns its sum.

    The result's own stress follows from the stage's implicit equation in closed form:
    (whole - last nu) rho Theta = second moments of the explicit part and of the first Gaussian
    + last (1 - nu) rho T I - (whole - last) rho u u.

    Parameters
    ----------
    first, sums : (>= 10,) arrays
        Sums 1, xi, xi xi of g^n and of the explicit part.
    weights : tuple of three floats
        first, last and whole (`scheme.py`).
    wanted : (5,) array
        Sums 1, xi, |xi|^2/2 of the result; `temperature` is the one they give.
    gaussian : Gaussian
        Receives the mean (3) and the tensor (6).
    """
    weight_first, weight_last, whole = weights
    mean, tensor = gaussian.mean, gaussian.tensor
    share = weight_first + weight_last
    rho0, rho = first[0], wanted[0]
    trace0 = (first[4] + first[7] + first[9]) - (first[1] ** 2 + first[2] ** 2 + first[3] ** 2) / rho0
    density = (weight_first * rho0 + weight_last * rho) / share
    for i in range(3):
        mean[i] = (weight_first * first[1 + i] + weight_last * wanted[1 + i]) / (share * density)
    q = 0
    for a in range(3):
        for b in range(a, 3):
            own0, own = 0.0, 0.0
            if a == b and a < d:
                own0 = (1.0 - nu) * trace0 / d
                own = (1.0 - nu) * rho * temperature
            uu0 = first[1 + a] * first[1 + b] / rho0
            uu = wanted[1 + a] * wanted[1 + b] / rho
            second0 = own0 + nu * (first[4 + q] - uu0) + uu0
            stress = (sums[4 + q] + weight_first * second0 + weight_last * own - (whole - weight_last) * uu) / (
                whole - weight_last * nu
            )
            second = own + nu * stress + uu
            tensor[q] = (weight_first * second0 + weight_last * second) / (share * density) - mean[a] * mean[b]
            q += 1
    return density


@part
def measure(grid, work):  # type: ignore[no-untyped-def]
    """Sums of the explicit part as it is, with the correction's factor left at one."""
    no_factor(work.correction)
    centre = work.correction.centre
    for q in range(3):
        centre[q] = 0.0
    weighted_sums(work.result, centre, grid, work.correction, work.sums.result)


@part
def sums_to_have(grid, model, weights, lacking, carried, omega, first, work):  # type: ignore[no-untyped-def]
    """Sums 1, xi, |xi|^2/2 at the end of a stage: those of the carried moments, or of the block's relaxed result.

    Parameters
    ----------
    weights : Weights
    lacking : float
        Weight that the first Gaussian has yet to be added with.
    carried, omega : (5,) array, float
        At the end of the stage.
    first : (10,) array
        Sums of g^n.
    """
    wanted, sums, before = work.sums.wanted, work.sums.result, work.sums.before
    for q in range(4):
        before[q] = first[q]
    before[4] = 0.5 * (first[4] + first[7] + first[9])
    if model.conservative:
        weight = grid.weight
        wanted[0] = carried[0] / weight
        if model.thermal:
            wanted[1], wanted[2], wanted[3], wanted[4] = 0.0, 0.0, 0.0, 0.5 * grid.dimensions * wanted[0]
            return
        for q in range(1, 4):
            wanted[q] = carried[q] / (weight * omega)
        wanted[4] = carried[4] / (weight * omega * omega)
        return
    measure(grid, work)
    for q in range(4):
        wanted[q] = sums[q]
    wanted[4] = 0.5 * (sums[4] + sums[7] + sums[9])
    whole = weights.old + weights.new + weights.first
    for q in range(5):
        wanted[q] = (wanted[q] + lacking * before[q]) / whole


@part
def relax(grid, model, weights, temperature, first, work):  # type: ignore[no-untyped-def]
    """Correct `work.result` to its moments, and find the Gaussian that it is relaxed to.

    Returns the mismatch removed, -1 where that failed, what `discrete_gaussian` says, and the Gaussian's share.
    """
    wanted, sums, gaussian = work.sums.wanted, work.sums.result, work.gaussian
    mismatch, answer, share = 0.0, EXACT, weights.first + weights.last
    if model.conservative and model.explicit:
        measure(grid, work)
    elif model.conservative:
        target, before = work.sums.target, work.sums.before
        for q in range(5):
            target[q] = (weights.whole - weights.last) * wanted[q] - weights.first * before[q]
        mismatch = correct(work.result, target, grid, work.correction, sums)
        if mismatch < 0.0:
            return mismatch, answer, 0.0
    if model.relaxes and share > 0.0:
        three = (weights.first, weights.last, weights.whole)
        density = blend(model.nu, grid.dimensions, first, sums, three, wanted, temperature, gaussian)
        answer = discrete_gaussian(
            density, gaussian.mean, gaussian.tensor, grid, work.fit, gaussian.block, gaussian.sums
        )
        # its mass to round-off, not only to Newton's tolerance
        share *= density / gaussian.sums[0] if answer <= REPLACED else 0.0
    return mismatch, answer, share


@part
def correct_signed(grid, model, share, whole, temperature, work):  # type: ignore[no-untyped-def]
    """The correction where an operator leaves g negative in places, far so where it is penalised.

    Its Gaussian is mixed in before. Returns the mismatch removed, -1 where that failed.
    """
    wanted, target, sums, gaussian = work.sums.wanted, work.sums.target, work.sums.result, work.gaussian
    if share > 0.0:
        for n in range(0, grid.block, 8):
            store(work.result, n, fma(load(gaussian.block, n), share, load(work.result, n)))
        for q in range(10):
            sums[q] += gaussian.sums[q] * share
    if not model.conservative:
        return 0.0
    for q in range(3):
        gaussian.mean[q] = wanted[1 + q] / wanted[0]
    answer = discrete_maxwellian(wanted[0], temperature, gaussian, grid, work.fit)
    if answer > REPLACED:
        return -1.0
    for q in range(5):
        target[q] = whole * wanted[q]
    return add_correction(work.result, gaussian.block, target, grid, work.correction, sums)
