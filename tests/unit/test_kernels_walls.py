"""What lies beyond the sides of the domain: ghost cells of g, and what follows for the fluxes through the wall."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy_twins import five_sums, gaussian, make_grid, nodes, pack, random_g, ten_sums, upwinded
from scipy.integrate import quad

from rvm_mpi.kinetic import walls
from rvm_mpi.step.data import kernel_grid

SETTINGS = settings(max_examples=40, deadline=None)
GRIDS = [(8,), (7,), (8, 6), (6, 6, 8), (9, 7, 5)]
CASE = {
    "points": st.sampled_from(GRIDS),
    "seed": st.integers(0, 2**32 - 1),
    "side": st.sampled_from(["x-lower", "x-upper", "y-lower", "y-upper"]),
}
COUNT = 3  # cells along the side
RATE = 5.0  # one over the width of a cell


def half_moments(normal, t):
    """The integrals of v M, v^2 M and v^3 M over v > 0."""

    def integrand(v, power):
        return v**power * np.exp(-0.5 * (v - normal) ** 2 / t) / np.sqrt(2 * np.pi * t)

    top = max(normal, 0.0) + 12.0 * np.sqrt(t)
    where = {"points": [max(normal, 0.01 * top)], "epsabs": 1e-14, "epsrel": 1e-13}
    return np.array([quad(integrand, 0.0, top, args=(p,), **where)[0] for p in (1, 2, 3)])


class Side:
    """A block of 3 x 3 cells with two ghost cells all round, and one of its sides filled."""

    def __init__(self, points, seed, side, signed=False):
        if len(points) == 1 and side[0] == "y":
            points = (*points, 6)
        self.grid, self.rng = make_grid(points), np.random.default_rng(seed)
        self.axis, self.sign = "xy".index(side[0]), 1 if side.endswith("lower") else -1
        cells = random_g(self.grid, self.rng, (7, 7))
        if signed:
            cells -= 0.5 * self.rng.random(cells.shape) * np.median(cells)
        self.before = cells
        self.d = len(points)
        self.omega = self.rng.uniform(0.5, 2.0, COUNT)
        self.states = np.zeros((COUNT, 5))
        self.states[:, 0] = self.rng.uniform(0.2, 3.0, COUNT)
        self.states[:, 1 : 1 + self.d] = 0.5 * self.rng.normal(size=(COUNT, self.d))
        self.states[:, 4] = self.rng.uniform(0.5, 3.0, COUNT)
        # the inner cells' own density, mean and temperature, as far as a side asks for them
        self.own = self.rng.uniform(0.5, 2.0, COUNT)

    def sums(self):
        """Sums of g over the nodes of the inner cells, at rest and isotropic: all that a side reads of them."""
        sums = np.zeros((COUNT, 10))
        sums[:, 0] = 1.7
        sums[:, [4, 7, 9][: self.d]] = (1.7 * self.own)[:, None]
        return sums

    def spacing(self):
        """Distance of the nodes along each axis in use."""
        return np.array([2.0 * v / n for v, n in zip(self.grid.half_width, self.grid.points)])[: self.d]

    def fill(self, kind, accommodation=1.0, carries=True):
        """Cells (along the side, from the far ghost inwards) before and after."""
        grid, block = self.grid, self.grid.block
        flat = pack(grid, self.before).reshape(-1)
        steps = (block, 7 * block)
        inward, along = self.sign * steps[self.axis], steps[1 - self.axis]
        inner = (2 if self.sign > 0 else 4) * steps[self.axis] + 2 * along
        self.beyond = np.full((COUNT, 5), np.nan)
        there = walls.Side(
            inner, along, inward, self.axis, self.sign, walls.KINDS[kind], accommodation, RATE if carries else 0.0
        )
        walls.fill_side(
            flat, there, self.states, self.omega, self.sums(), kernel_grid(grid),
            np.zeros((6, grid.nodes.shape[1])), self.beyond,
        )  # fmt: skip
        after = grid.unpack(flat.reshape(7, 7, block))
        changed = np.any(after != self.before, axis=(2, 3, 4))
        ghosts = np.zeros((7, 7), dtype=bool)
        rows = ghosts if self.axis == 1 else ghosts.T
        rows[[0, 1] if self.sign > 0 else [5, 6], 2:5] = True
        assert not np.any(changed & ~ghosts)  # nothing but this side's ghosts, no corners
        assert not flat.reshape(-1, grid.slab_size)[:, grid.slab_points :].any()  # the padding stays empty
        return self.ordered(after)

    def ordered(self, cells):
        """(along the side, from the far ghost inwards, ...)"""
        cells = cells if self.axis == 0 else np.swapaxes(cells, 0, 1)
        return cells[2:5, :: self.sign]

    def inward_speed(self):
        return self.sign * nodes(self.grid)[self.axis] * np.ones(self.grid.points)

    def face_flux(self, after):
        """xi_n g on the wall's face, n inward: (COUNT, ...)."""
        far, near, here, inside = (after[:, k] for k in range(4))
        return self.inward_speed() * upwinded(far, near, here, inside, self.inward_speed())


@SETTINGS
@given(**CASE, signed=st.booleans())
def test_specular_walls_mirror(points, seed, side, signed):
    s = Side(points, seed, side, signed)
    after = s.fill("specular")
    flip = 2 + s.axis
    np.testing.assert_array_equal(after[:, 1], np.flip(after[:, 2], flip - 1))
    np.testing.assert_array_equal(after[:, 0], np.flip(after[:, 3], flip - 1))
    through = five_sums(s.grid, s.face_flux(after))
    scale = five_sums(s.grid, np.abs(s.face_flux(after)))[:, 0]
    assert np.all(np.abs(through[:, 0]) <= 1e-14 * scale)  # no mass
    assert np.all(np.abs(through[:, 4]) <= 1e-14 * 150 * scale)  # no energy
    for q in range(3):
        if q != s.axis:
            assert np.all(np.abs(through[:, 1 + q]) <= 1e-14 * 7 * scale)  # no shear


@SETTINGS
@given(**CASE, signed=st.booleans(), accommodation=st.sampled_from([0.3, 1.0, 1e-3]))
def test_no_mass_through_a_maxwell_wall(points, seed, side, signed, accommodation):
    s = Side(points, seed, side, signed)
    s.states[:, 1 + s.axis] = 0.0
    after = s.fill("maxwell", accommodation)
    flux = s.face_flux(after)
    assert np.all(np.abs(flux.sum(axis=(1, 2, 3))) <= 2e-15 * np.abs(flux).sum(axis=(1, 2, 3)))
    # what enters: the mirrored outflow, and a Gaussian of the wall
    inward = s.inward_speed()
    reflected = np.flip(flux / np.where(inward == 0, np.inf, inward), 1 + s.axis)
    entering = inward > 0
    for c in range(COUNT):
        rest = after[c, 1] - (1.0 - accommodation) * reflected[c]
        through = flux[c][entering] / inward[entering]
        np.testing.assert_allclose(through, after[c, 1][entering], rtol=1e-15, atol=1e-15 * after[c, 2].max())
        if accommodation < 0.1:
            continue  # the small difference of large numbers
        strongest = entering & (rest >= 1e-3 * rest[entering].max())
        x = nodes(s.grid)
        terms = [np.ones(s.grid.points)] + [x[q] ** p + np.zeros(s.grid.points) for q in range(s.d) for p in (1, 2)]
        design = np.array([term[strongest] for term in terms]).T
        logarithm = np.log(rest[strongest])
        fitted = design @ np.linalg.lstsq(design, logarithm, rcond=None)[0]
        np.testing.assert_allclose(fitted, logarithm, atol=1e-7)


def entering_moments(s, after):
    """Rates of mass, momentum and energy along the axis that a side's ghost cells send in, and beyond them: (COUNT, 5).

    By the definition: sums over the nodes that enter of omega xi_n g times 1, omega xi, omega^2 |xi|^2/2.
    """
    flux = np.where(s.inward_speed() > 0, s.sign * s.face_flux(after), 0.0)
    sums = five_sums(s.grid, flux) * (RATE * s.grid.weight)
    powers_of_omega = s.omega[:, None] ** np.array([1, 2, 2, 2, 3])
    return sums * powers_of_omega * np.array([1.0, 1.0, 1.0, 1.0, 0.5]) + s.beyond


STATES = {"temperature": st.floats(0.01, 20.0), "speed": st.floats(0.0, 2.0), "own": st.floats(0.3, 3.0)}


@SETTINGS
@given(**CASE, **STATES, kind=st.sampled_from(["maxwell", "far-field"]))
def test_what_enters_has_the_moments_of_the_sides_state(points, seed, side, temperature, speed, own, kind):
    """Across the side exactly, whatever the grid; along the normal as its half-space has them, where that is resolved.

    Temperatures down to far below what the nodes hold in the inner cell's omega, and up to far above the box.
    """
    s = Side(points, seed, side)
    s.states[:, 4] = temperature * s.rng.uniform(0.8, 1.2, COUNT)
    s.states[:, 1:4] *= speed * np.sqrt(temperature)
    if kind == "maxwell":
        s.states[:, 1 + s.axis] = 0.0
    s.own[:] = own
    found = entering_moments(s, s.fill(kind))
    # what is on the face is a difference from the inner cell's g
    rounded = 1e-14 * RATE * s.before.max() * s.grid.weight * s.grid.block
    h, n = s.spacing(), s.axis
    for c in range(COUNT):
        state, mass = s.states[c], found[c, 0]
        inward, t = s.sign * state[1 + n], state[4]
        exact = half_moments(inward, t)
        # half the nodes miss h^2/24 M'(0) of the half-space's flux, with a node at zero h^2/12; h^2 is at most t here
        slope = np.exp(-0.5 * inward**2 / t) / np.sqrt(2 * np.pi * t)
        missed = 1.5 / (12 if s.grid.points[n] % 2 else 24) * t * slope / exact[0]
        resolved = own >= h[n] ** 2 and abs(inward) < 0.5 * np.sqrt(t)
        if kind == "far-field" and resolved:
            assert s.sign * mass == pytest.approx(RATE * state[0] * exact[0], rel=missed)
        assert s.sign * mass > 0.0
        across = [q for q in range(s.d) if q != n]
        for q in across:
            assert found[c, 1 + q] == pytest.approx(mass * state[1 + q], rel=1e-10, abs=1e-10 * abs(mass) + rounded)
        rest = found[c, 4] / mass - 0.5 * sum(state[1 + q] ** 2 + t for q in across)
        assert rest > 0.0
        if resolved:
            ratio = missed / (1.0 - missed)
            assert s.sign * found[c, 1 + n] / mass == pytest.approx(exact[1] / exact[0], rel=ratio)
            assert rest == pytest.approx(0.5 * exact[2] / exact[0], rel=ratio)


@SETTINGS
@given(**CASE, kind=st.sampled_from(["maxwell", "far-field"]))
def test_gas_at_the_sides_own_state_is_met_by_itself(points, seed, side, kind):
    """The discrete Gaussian that a gas in equilibrium has: to round-off, on any number of points, nothing beyond it."""
    s = Side(points, seed, side)
    if kind == "maxwell":
        s.states[:, 1 + s.axis] = 0.0
    smallest = np.max(s.spacing() ** 2) * 0.35
    s.states[:, 4] = s.omega**2 * s.rng.uniform(smallest, 1.5 * smallest + 1.0, COUNT)
    s.states[:, 1:4] *= 0.2 * np.sqrt(s.states[:, 4:])
    own = np.zeros((COUNT, 10))
    for c in range(COUNT):
        mean, variance = s.states[c, 1:4] / s.omega[c], s.states[c, 4] / s.omega[c] ** 2
        tensor = variance * np.eye(s.d)
        block = gaussian(s.grid, s.states[c, 0] / s.grid.weight, mean, tensor)
        at = (slice(None), 2 + c) if s.axis == 1 else (2 + c, slice(None))
        s.before[at] = block
        own[c] = ten_sums(s.grid, block)
    s.sums = lambda: own
    after = s.fill(kind)
    entering = s.inward_speed() > 0
    for c in range(COUNT):
        scale = s.ordered(s.before)[c, 2].max()
        # walls give back what hits them: at rest along the normal that is as much as the Gaussian sends in
        np.testing.assert_allclose(after[c, 1][entering], after[c, 2][entering], rtol=1e-10, atol=1e-12 * scale)
    assert np.all(np.abs(s.beyond) <= 1e-9 * s.states[:, :1] * (1.0 + s.states[:, 4:]) ** 1.5 * RATE)


@pytest.mark.parametrize("kind", ["maxwell", "far-field"])
def test_nothing_beyond_g_where_no_moments_are_carried(kind):
    s = Side((8, 6), 3, "y-upper")
    s.states[:, 1 + s.axis] = 0.0
    s.states[:, 4] = 1e-3
    s.fill(kind, carries=False)
    assert not s.beyond.any()


@SETTINGS
@given(**CASE)
def test_vacuum_and_outflow(points, seed, side):
    s = Side(points, seed, side)
    entering = s.inward_speed() > 0
    after = s.fill("vacuum")
    flux = s.face_flux(after)
    assert not flux[:, entering].any()
    assert np.all(flux[:, s.inward_speed() < 0] < 0.0)
    after = s.fill("outflow")
    np.testing.assert_array_equal(after[:, 0], after[:, 2])
    np.testing.assert_array_equal(after[:, 1], after[:, 2])


@pytest.mark.parametrize("kind", ["maxwell", "far-field", "vacuum"])
def test_a_linear_profile_leaves_with_its_value_on_the_face(kind):
    """Second order up to the wall."""
    s = Side((8, 6, 6), 5, "x-upper")
    slope = 0.2 * s.rng.random(s.grid.points)
    profile = np.arange(7).reshape(1, 7, 1, 1, 1) * slope + 3.0
    s.before = np.broadcast_to(profile, s.before.shape).copy()
    s.states[:, 1:4] = 0.0
    after = s.fill(kind, 1.0)
    leaving = s.inward_speed() < 0
    face = (s.face_flux(after) / s.inward_speed())[:, leaving]
    np.testing.assert_allclose(face, np.broadcast_to((3.0 + 4.5 * slope)[leaving], face.shape), rtol=1e-13)
