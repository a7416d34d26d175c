"""What a stage is made of, against plain NumPy; whole steps are in tests/verification/test_reference.py."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy_twins import SHAPES, gaussian, kernel_drift, make_grid, make_work, nodes, pack, random_g, ten_sums

from rvm_mpi.grid.domain import Domain
from rvm_mpi.job.job import Job
from rvm_mpi.kinetic.drift import Mix
from rvm_mpi.reference.transport import face_values
from rvm_mpi.step import carried, explicit, scaling
from rvm_mpi.step.data import Space, here, kernel_grid
from rvm_mpi.step.relaxation import blend
from rvm_mpi.step.stepper import KineticStepper
from rvm_mpi.step.sweep import mix
from rvm_mpi.time_limits import FITS

SETTINGS = settings(max_examples=40, deadline=None)
SEED = st.integers(0, 2**32 - 1)


@SETTINGS
@given(
    thermal=st.floats(1e-3, 1e3), density=st.floats(1e-3, 1e3), d=st.integers(1, 3), cooling=st.floats(0.0, 10.0),
    dt=st.floats(0.0, 10.0),
)  # fmt: skip
def test_haff(thermal, density, d, cooling, dt):
    """1/sqrt(T) grows linearly at the rate cooling rho, and time runs backwards too."""
    after = carried.cooled(thermal, density, d, cooling, dt)
    before, now = (1.0 / np.sqrt(2.0 * e / (d * density)) for e in (thermal, after))
    assert now == pytest.approx(before + cooling * density * dt, rel=1e-13)
    assert carried.cooled(after, density, d, cooling, -dt) == pytest.approx(thermal, rel=1e-10 * (now / before) ** 2)


@SETTINGS
@given(points=st.sampled_from(SHAPES), seed=SEED, share=st.sampled_from([0.0, 0.3, 1.0]))
def test_mix(points, seed, share):
    grid, rng = make_grid(points), np.random.default_rng(seed)
    kernel = kernel_grid(grid)
    block, gaussian = random_g(grid, rng, signed=True), random_g(grid, rng)
    fx, fs = rng.random(grid.points[0]), rng.random(grid.slab_size)
    out, work = rng.normal(size=3 * grid.block), make_work(kernel)
    before = out.copy()
    dirty = pack(grid, block)
    dirty.reshape(-1, grid.slab_size)[:, grid.slab_points :] = 1e9  # whatever the padding holds
    work.result[:], work.gaussian.block[:] = dirty, pack(grid, gaussian)
    work.correction.factor_x[:], work.correction.factor_slab[:] = fx, fs
    extremes = mix(kernel, work, 0.7, share, out, grid.block, True)
    factor = fx[:, None, None] * fs[: grid.slab_points].reshape(1, *grid.points[1:])
    wanted = 0.7 * block * factor + share * gaussian
    found = out[grid.block : 2 * grid.block]
    np.testing.assert_allclose(grid.unpack(found), wanted, rtol=1e-13, atol=1e-15 * np.abs(wanted).max())
    assert not found.reshape(-1, grid.slab_size)[:, grid.slab_points :].any()
    assert (extremes[0], extremes[1]) == (grid.unpack(found).min(), grid.unpack(found).max())
    outer = wanted.copy()
    outer[tuple(slice(1, -1) if n > 1 else slice(None) for n in grid.points)] = 0.0
    speed2 = sum(axis**2 for axis in nodes(grid))
    scale = np.abs(outer).sum()
    assert extremes[2] == pytest.approx(outer.sum(), abs=1e-13 * scale)
    assert extremes[3] == pytest.approx((outer * speed2).sum(), abs=1e-13 * scale * speed2.max())
    untouched = np.r_[0 : grid.block, 2 * grid.block : 3 * grid.block]
    np.testing.assert_array_equal(out[untouched], before[untouched])


@SETTINGS
@given(
    points=st.sampled_from([(8,), (8, 8), (8, 8, 8)]), seed=SEED, nu=st.sampled_from([-0.5, 0.0, 0.4]),
    second=st.booleans(), z=st.floats(1e-6, 1e4),
)  # fmt: skip
def test_blend(points, seed, nu, second, z):
    """The mixture of both Gaussians solves the implicit equation of the stage: put in, it gives the result back."""
    grid, rng = make_grid(points), np.random.default_rng(seed)
    d = len(points)
    nu = nu if d > 1 else 0.0
    first, explicit = rng.random(grid.points), rng.random(grid.points)
    w0, w1 = (0.5 * z, 0.5 * z * z) if second else (0.0, z)
    whole = 1.0 + 2.0 * w0 + w1
    s0, s = ten_sums(grid, first), ten_sums(grid, explicit) * (1.0 + w0)
    wanted = (s[:4] + w0 * s0[:4]) / (whole - w1)
    energy = 0.5 * ((s + w0 * s0)[[4, 7, 9]]).sum() / (whole - w1)
    wanted = np.array([*wanted, energy])
    temperature = (2.0 * energy / wanted[0] - (wanted[1:4] ** 2).sum() / wanted[0] ** 2) / d
    mixed = make_work(kernel_grid(grid)).gaussian
    density = blend(nu, d, s0, s, (w0, w1, whole), wanted, temperature, mixed)
    centre, tensor = mixed.mean, mixed.tensor
    # what the result is, if the blended Gaussian has these moments
    full = np.zeros((3, 3))
    for value, (a, b) in zip(tensor, [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)], strict=True):
        full[a, b] = full[b, a] = value
    mixture = density * (full + np.outer(centre, centre))[:d, :d]
    result = (second_of(s, d) + (w0 + w1) * mixture) / whole
    own = [
        rho * (relaxed(m / rho - np.outer(u, u), nu) + np.outer(u, u))
        for m, rho, u in (
            (second_of(s0, d), s0[0], (s0[1:4] / s0[0])[:d]),
            (result, wanted[0], (wanted[1:4] / wanted[0])[:d]),
        )
    ]
    np.testing.assert_allclose((w0 + w1) * mixture, w0 * own[0] + w1 * own[1], atol=1e-12 * (w0 + w1) * 50 * density)
    assert (w0 + w1) * density == pytest.approx(w0 * s0[0] + w1 * wanted[0], rel=1e-13)
    momentum = w0 * s0[1:4] + w1 * wanted[1:4]
    np.testing.assert_allclose((w0 + w1) * density * centre, momentum, atol=1e-12 * (w0 + w1) * density)


def relaxed(theta, nu):
    """(1 - nu) T I + nu Theta."""
    return (1.0 - nu) * np.trace(theta) / len(theta) * np.eye(len(theta)) + nu * theta


def second_of(sums, d):
    full = np.zeros((3, 3))
    for value, (a, b) in zip(sums[4:10], [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)], strict=True):
        full[a, b] = full[b, a] = value
    return full[:d, :d]


@SETTINGS
@given(values=st.lists(st.floats(0.1, 10.0), min_size=4, max_size=4))
def test_omega_at_a_face(values):
    """As the twin has it along x and along y, and the same bits with up and down exchanged."""
    row = np.random.default_rng(0).uniform(0.5, 2.0, (4, 4))
    along_x, along_y = row.copy(), row.copy()
    along_x[2], along_y[:, 2] = values, values
    found = scaling.face_omega(True, along_x, 2, 1, 0, 1)
    np.testing.assert_allclose(found, [one[0] for one in face_values(np.array(values), 0.0)], rtol=1e-14)
    assert scaling.face_omega(True, along_y, 1, 2, 1, 0) == found
    assert scaling.face_omega(True, along_x[:, ::-1].copy(), 2, 1, 0, 1) == found[::-1]
    a, b, c, e = values
    assert scaling.face_omega(False, along_x, 2, 1, 0, 1) == (0.5 * (b + c), 0.5 * (b + c))
    for value, around in zip(found, ((a, b, c), (b, c, e))):
        assert min(around) * (1.0 - 4e-16) <= value <= max(around) * (1.0 + 4e-16)


@pytest.mark.parametrize(
    ("profile", "sides"),
    [((1, 2, 3, 4), (2.5, 2.5)), ((1, 1, 2, 2), (1, 2)), ((1, 2, 1, 2), (2, 1)), ((3, 3, 3, 3), (3, 3))],
)
def test_omega_at_a_face_by_hand(profile, sides):
    """Linear: the mean. A jump or an odd-even pattern: what each cell has."""
    assert scaling.face_omega(True, np.array([profile], dtype=float), 0, 1, 0, 1) == sides


# -- the drift by itself -------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [np.nan, np.inf, 1e300])
def test_a_rate_that_is_no_number_is_one_piece(rate):
    assert explicit.drift_substeps(0.1, 1.0, rate, 0.5) == 1


@SETTINGS
@given(crossing=st.floats(0.0, 10.0), drifting=st.floats(0.0, 1e3), dt=st.floats(0.0, 1.0))
def test_substeps_of_the_drift(crossing, drifting, dt):
    """None where both fit into one step, else so many that each of them does, and not one more."""
    substeps = explicit.drift_substeps(dt, crossing, drifting, 0.5)
    most = 0.5 * FITS
    if dt * (crossing + drifting) < 0.999999 * most:
        assert substeps == 0
    elif dt * (crossing + drifting) > 1.000001 * most:
        assert substeps >= 1
        assert dt * drifting / substeps < 0.500001
        assert substeps == 1 or dt * drifting / (substeps - 1) > 0.499999


# -- a gas that omega must not stir --------------------------------------------------------------------------


def rates_of_a_gas_at_rest(omega, points, conservative):
    """Largest rates of change (of mass, momentum, energy; per width of a cell) in a first stage without collisions.

    The gas has density and temperature 1 everywhere, only omega differs: nothing should happen.
    """
    n = omega.size
    job = Job.from_dict(
        {
            "initial": {"state": "uniform"}, "time": {"end": 1.0}, "scaling": {"kind": "macroscopic"},
            "space": {"cells": [n]}, "velocity": {"points": [points], "half_width": 10.0},
            "collision": {"operator": "none"}, "scheme": {"conservative": conservative},
        }
    )  # fmt: skip
    one = np.ones((1, n))
    stepper = KineticStepper(job, Domain(job), one, np.zeros((1, n, 1)), omega.reshape(1, n, 1, 1) ** 2)
    grid, wx = stepper.velocity_grid, stepper.space.wx
    np.testing.assert_allclose(stepper.omega[0], omega, rtol=1e-15)
    for i, w in enumerate(omega):
        stepper.g[0, wx + i] = pack(grid, gaussian(grid, 1.0 / grid.weight, np.zeros(3), np.array([[1.0 / w**2]])))
    stepper.now.carried[...] = [1.0, 0.0, 0.0, 0.0, 0.5]
    stepper.refresh_sums()
    stepper.set_scaling(omega[None], 1.0)
    stepper.first_stage(0.0)
    dt = 0.4 / stepper.rate
    stepper.first_stage(dt)
    sums = grid.weight * stepper.last.new.sums[0]
    state = np.stack([sums[:, 0], omega * sums[:, 1], 0.5 * omega**2 * sums[:, 4]], axis=-1)
    if conservative:
        np.testing.assert_allclose(stepper.last.new.carried[0][:, [0, 1, 4]], state, rtol=1e-13, atol=1e-13)
    return np.abs(state - [1.0, 0.0, 0.5]).max(axis=0) / (dt * n)


def test_an_omega_that_jumps_does_not_move_a_gas_at_rest():
    """Odd-even omega: each face passes what the half gas of either side sends, but for the sampling of xi > 0.

    The midpoint rule for the integral of omega xi g over xi > 0 is off by h^2 omega g(0)/24 = h^2 omega^2/(24 sqrt(2
    pi)), g a Gaussian of temperature 1/omega^2, and by terms in h^4; it counts twice, once for each face.
    """
    low, high = 0.8, 1.25
    omega = np.tile([low, high], 4)
    for points in (64, 128, 256):
        h = 20.0 / points
        sampling = 2.0 * h**2 / 24.0 * (high**2 - low**2) / np.sqrt(2.0 * np.pi)
        mass, momentum, energy = rates_of_a_gas_at_rest(omega, points, conservative=True)
        # the limiter leaves g on a face a fiftieth of room, omega none
        assert sampling * (1.0 - h**2) < mass < sampling + 0.01
        assert momentum < 1e-12
        assert energy < 0.03


def test_without_carried_moments_an_omega_that_jumps_stirs_a_gas_at_rest():
    """Both faces of a cell pass mean omega times what the half gases g of either side send, and nothing undoes it."""
    low, high = 0.8, 1.25
    half = 1.0 / np.sqrt(2.0 * np.pi)  # sum of |xi| omega over xi > 0; that of |xi|^3 omega^3 is twice it
    mean = 0.5 * (low + high)
    mass, momentum, energy = rates_of_a_gas_at_rest(np.tile([low, high], 4), 256, conservative=False)
    # but for the fiftieth of room that the limiter leaves g on a face
    assert mass == pytest.approx(2.0 * mean * half * (1.0 / low - 1.0 / high), rel=0.03)
    assert energy == pytest.approx(high**2 * mean * 2.0 * half * (low**-3 - high**-3), rel=0.03)
    assert momentum < 1e-12


def test_any_omega_hardly_moves_a_gas_at_rest():
    """Where the limiter does not vanish, omega and g on a face match to what two reconstructions leave."""
    omega = np.random.default_rng(0).uniform(0.8, 1.25, 12)
    assert rates_of_a_gas_at_rest(omega, 128, conservative=True)[0] < 7e-3
    # the mean of two cells on their face: half a gas from each side, by the ratios of omega
    half = 1.0 / np.sqrt(2.0 * np.pi)
    mean = 0.5 * (omega + np.roll(omega, -1)) * (1.0 / omega - 1.0 / np.roll(omega, -1)) * half
    assert np.abs(mean - np.roll(mean, 1)).max() > 0.1


def test_substeps_lose_no_mass():
    """Weights of the last substep that are one together; 1/3 and 2/3, each rounded, lose 5.5e-17 each time."""
    grid = make_grid((8, 8, 8))
    kernel = kernel_grid(grid)
    work, cell = make_work(kernel), here.py_func(kernel, Space(0, 1, 1, 0, 0, 0.0, 0.0), 0, 0)
    g = random_g(grid, np.random.default_rng(5)).reshape(-1)
    before = math.fsum(g)
    for n in range(400):
        turn = kernel_drift(grid, (0.2 * (-1) ** n, 0, 0, 0, 0, 0, 0, 0))
        work.result[:] = 0.0
        explicit.take_substeps(g, cell, kernel, turn, Mix(g, 0.0, 1.0, 0.1), 0.0, 2, work)
        g[:] = work.result
    assert abs(math.fsum(g) / before - 1.0) < 400 * 5.5e-17 / 4
