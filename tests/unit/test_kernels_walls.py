"""What lies beyond the sides of the domain: ghost cells of g, and what follows for the fluxes through the wall."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy_twins import five_sums, make_grid, nodes, pack, random_g, upwinded
from scipy.integrate import quad

from rvm_mpi.kinetic import walls
from rvm_mpi.stage import kernel_grid

SETTINGS = settings(max_examples=40, deadline=None)
GRIDS = [(8,), (7,), (8, 6), (6, 6, 8), (9, 7, 5)]
CASE = {
    "points": st.sampled_from(GRIDS),
    "seed": st.integers(0, 2**32 - 1),
    "side": st.sampled_from(["x-lower", "x-upper", "y-lower", "y-upper"]),
}
COUNT = 3  # cells along the side


def half_flux(normal, t):
    """The integral of v M(v) over v > 0."""

    def integrand(v):
        return v * np.exp(-0.5 * (v - normal) ** 2 / t) / np.sqrt(2 * np.pi * t)

    top = max(normal, 0.0) + 12.0 * np.sqrt(t)
    return quad(integrand, 0.0, top, points=[max(normal, 0.01 * top)], epsabs=1e-14, epsrel=1e-13)[0]


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

    def fill(self, kind, accommodation=1.0):
        """Cells (along the side, from the far ghost inwards) before and after."""
        grid, block = self.grid, self.grid.block
        flat = pack(grid, self.before).reshape(-1)
        steps = (block, 7 * block)
        inward, along = self.sign * steps[self.axis], steps[1 - self.axis]
        inner = (2 if self.sign > 0 else 4) * steps[self.axis] + 2 * along
        walls.fill_side(
            flat, inner, along, inward, COUNT, self.axis, self.sign, walls.KINDS[kind], accommodation,
            self.states, self.omega, kernel_grid(grid), np.zeros((4, max(grid.nodes.shape[1], 3))),
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
    # what enters: the mirrored outflow, and the Maxwellian of the wall in the inner cell's omega
    inward = s.inward_speed()
    reflected = np.flip(flux / np.where(inward == 0, np.inf, inward), 1 + s.axis)
    entering = inward > 0
    for c in range(COUNT):
        rest = after[c, 1] - (1.0 - accommodation) * reflected[c]
        x = nodes(s.grid)
        square = sum((x[q] - s.states[c, 1 + q] / s.omega[c]) ** 2 for q in range(3))
        wall = np.exp(-0.5 * square * s.omega[c] ** 2 / s.states[c, 4])
        strongest = entering & (wall >= 1e-3 * wall[entering].max())
        ratio = rest[strongest] / wall[strongest]
        # where the wall sends back a share below 1e-3 of rough data, it is the small difference of large numbers
        np.testing.assert_allclose(ratio, ratio.mean(), rtol=1e-9, atol=1e-12 * np.abs(after[c, 1]).max() / 1e-3)
        assert np.all(after[c, 0][entering] == after[c, 1][entering])


@SETTINGS
@given(**CASE)
def test_far_field_sends_in_the_exact_flux_or_a_resolved_maxwellian(points, seed, side):
    """Narrower than half the spacing: the exact flux; wider than 0.71 of it: a Maxwellian of the far density."""
    s = Side(points, seed, side)
    s.states[:, 4] *= s.rng.choice([0.03, 1.0, 10.0], COUNT)
    after = s.fill("far-field")
    entering = s.inward_speed() > 0
    flux = s.face_flux(after)
    spacing = np.diff(s.grid.nodes[s.axis][:2])[0]
    for c in range(COUNT):
        found = s.omega[c] * s.grid.weight * flux[c][entering].sum()
        normal, t, rho = s.sign * s.states[c, 1 + s.axis], s.states[c, 4], s.states[c, 0]
        exact = rho * half_flux(normal, t)
        square = sum((nodes(s.grid)[q] - s.states[c, 1 + q] / s.omega[c]) ** 2 for q in range(3))
        shape = np.exp(-0.5 * square * s.omega[c] ** 2 / t) * np.ones(s.grid.points)
        whole = rho * s.omega[c] * (s.inward_speed() * shape)[entering].sum() / shape.sum()
        share = np.clip(4 * t / (s.omega[c] * spacing) ** 2 - 1, 0, 1)
        assert found == pytest.approx((1 - share) * exact + share * whole, rel=1e-11)
        strong = entering & (shape > 1e-10 * shape[entering].max())
        ratio = after[c, 1][strong] / shape[strong]
        np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)


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


@SETTINGS
@given(normal=st.floats(-5.0, 5.0), temperature=st.floats(0.1, 10.0))
def test_inward_flux(normal, temperature):
    exact = half_flux(normal, temperature)
    assert walls.inward_flux(2.0, normal, temperature) == pytest.approx(2.0 * exact, rel=1e-9, abs=1e-13)
