"""FluidSystem: states, cooling, walls, decompositions and failures."""

import threading

import numpy as np
import pytest

from rvm_mpi.fluid import GHOSTS, FluidSystem
from tests.unit.serial_domain import BlockDomain, Blocks, SerialDomain, make_job


def system(cells, sides="periodic", d=3, cooling=0.0, upper=None):
    job = make_job(cells, (0.0,) * len(cells), upper or (1.0,) * len(cells), sides, d, cooling)
    return FluidSystem(job, SerialDomain(job))


def random_fields(rng, ny, nx, d):
    return rng.random((ny, nx)) + 0.1, 0.3 * rng.normal(size=(ny, nx, d)), rng.random((ny, nx)) + 0.1


def run(fluid, time, number=0.5):
    t = 0.0
    while t < time:
        dt = min(number / fluid.max_rate(), time - t)
        fluid.advance(dt)
        t += dt


@pytest.mark.parametrize(("cells", "d"), [((), 3), ((8,), 1), ((6, 5), 2), ((6, 5), 3)])
def test_moments_and_omega(cells, d):
    rng = np.random.default_rng(0)
    fluid = system(cells, d=d)
    nx, ny = (*cells, 1, 1)[:2]
    density, velocity, temperature = random_fields(rng, ny, nx, d)
    fluid.set_state(density, velocity, temperature)
    for got, given in zip(fluid.moments(), (density, velocity, temperature), strict=True):
        assert np.allclose(got, given, rtol=1e-14)
    omega = np.sqrt(temperature + (velocity**2).sum(-1) / d)
    assert np.allclose(fluid.omega(), omega, rtol=1e-14)
    for width in range(1, 4):
        wy, wx = (width if len(cells) == 2 else 0), (width if len(cells) else 0)
        out = np.empty((ny + 2 * wy, nx + 2 * wx))
        assert fluid.omega(out) is out
        assert np.allclose(out[wy : wy + ny, wx : wx + nx], omega, rtol=1e-14)
        assert np.allclose(out[wy : wy + ny], np.pad(omega, ((0, 0), (wx, wx)), mode="wrap"), rtol=1e-14)
        assert np.allclose(out[:, wx : wx + nx], np.pad(omega, ((wy, wy), (0, 0)), mode="wrap"), rtol=1e-14)
    with pytest.raises(ValueError, match="omega"):
        fluid.omega(np.empty((ny + 8, nx + 8)))
    with pytest.raises(ValueError, match="positive"):
        fluid.set_state(0.0 * density, velocity, temperature)


@pytest.mark.parametrize("cells", [(), (5,), (4, 5)])
@pytest.mark.parametrize("dt", [1e-3, 1.0, 1e4])
def test_homogeneous_cooling_is_exact_whatever_the_step(cells, dt):
    fluid = system(cells, cooling=2.35)
    shape = (*cells, 1, 1)[:2][::-1]
    fluid.set_state(np.full(shape, 0.7), np.zeros((*shape, 3)), np.full(shape, 2.0))
    for _ in range(3):
        fluid.advance(dt)
    exact = 2.0 / (1.0 + 2.35 * 0.7 * np.sqrt(2.0) * 3 * dt) ** 2
    density, velocity, temperature = fluid.moments()
    assert np.allclose(temperature, exact, rtol=2e-14)
    assert np.allclose(density, 0.7, rtol=1e-14)
    assert not velocity.any()


def test_relaxation_towards_the_kinetic_moments():
    rng = np.random.default_rng(3)
    fluid = system((6, 5))
    fluid.set_state(*random_fields(rng, 5, 6, 3))
    before, target = fluid.interior.copy(), 1.0 + rng.random((5, 6, 5))
    fluid.relax_towards(target, 0.0, 0.1)
    assert np.array_equal(fluid.interior, before)
    fluid.relax_towards(target, 200.0, 0.01)
    assert np.allclose(fluid.interior, target + np.exp(-2.0) * (before - target), rtol=1e-14)


@pytest.mark.parametrize("d", [1, 3])
def test_uniform_flow_stays_uniform(d):
    sides = {
        "x-lower": {"kind": "far-field", "density": 0.3, "velocity": [0.5] * d, "temperature": 2.0},
        "x-upper": "outflow",
    }
    fluid = system((12,), sides, d)
    fluid.set_state(np.full((1, 12), 0.3), np.full((1, 12, d), 0.5), np.full((1, 12), 2.0))
    before = fluid.interior.copy()
    run(fluid, 0.3)
    assert np.allclose(fluid.interior, before, rtol=1e-13)


def test_ghosts_of_every_kind_of_side():
    rng = np.random.default_rng(4)
    wall = {"kind": "maxwell", "accommodation": 0.25, "temperature": 3.0, "velocity": [0.0, 0.4, -0.2]}
    far = {"kind": "far-field", "density": 0.2, "velocity": [0.1, 0.2, 0.3], "temperature": 0.5}
    for lower, upper in (("specular", wall), ("vacuum", "outflow"), (far, "far-field")):
        for axis in "xy":
            other = "y" if axis == "x" else "x"
            sides = {f"{axis}-lower": lower, f"{axis}-upper": upper}
            sides |= {f"{other}-{end}": "periodic" for end in ("lower", "upper")}
            fluid = system((6, 6), sides)
            fluid.set_state(*random_fields(rng, 6, 6, 3))
            initial = fluid.interior.copy() if axis == "x" else fluid.interior.transpose(1, 0, 2).copy()
            fluid.interior[:] *= 1.5
            fluid.fill_ghosts()
            state = fluid.state if axis == "x" else fluid.state.transpose(1, 0, 2)
            state = state[GHOSTS:-GHOSTS]
            inside, below, above = state[:, GHOSTS:-GHOSTS], state[:, :GHOSTS], state[:, -GHOSTS:]
            sign = np.array([1, -1, 1, 1, 1] if axis == "x" else [1, 1, -1, 1, 1])
            if lower == "specular":
                assert np.array_equal(below, sign * inside[:, 2::-1])
                mirrored = sign * inside[:, :2:-1]
                u = mirrored[..., 1:4] / mirrored[..., :1]
                for c, speed in enumerate(wall["velocity"]):
                    if c != "xy".index(axis):
                        u[..., c] = speed
                energy = 0.5 * mirrored[..., 0] * (3 * 3.0 + (u**2).sum(-1))
                thermal = np.concatenate(
                    [mirrored[..., :1], mirrored[..., :1] * u, energy[..., None]], axis=-1
                )
                assert np.allclose(above, 0.75 * mirrored + 0.25 * thermal, rtol=1e-14)
            elif lower == "vacuum":
                assert np.allclose(below, 1e-10 * inside[:, :1], rtol=1e-14, atol=0.0)
                assert np.array_equal(above, np.repeat(inside[:, -1:], 3, axis=1))
            else:
                assert np.allclose(below, [0.2, 0.02, 0.04, 0.06, 0.1 * (3 * 0.5 + 0.14)], rtol=1e-14)
                assert np.array_equal(above, np.repeat(initial[:, -1:], 3, axis=1))


@pytest.mark.parametrize("axis", ["x", "y"])
def test_specular_box_is_half_of_a_mirrored_periodic_one(axis):
    """The same bits as in the enlarged problem; mass to round-off."""
    rng = np.random.default_rng(6)
    n = 12
    density, velocity, temperature = random_fields(rng, n, n, 3)
    other = "y" if axis == "x" else "x"
    sides = {f"{axis}-{e}": "specular" for e in ("lower", "upper")}
    sides |= {f"{other}-{e}": "periodic" for e in ("lower", "upper")}
    box = system((n, n), sides)
    box.set_state(density, velocity, temperature)
    along, normal = (1, 0) if axis == "x" else (0, 1)
    reflected = velocity.copy()
    reflected[..., normal] *= -1
    double = system(
        (2 * n, n) if axis == "x" else (n, 2 * n), upper=(2.0, 1.0) if axis == "x" else (1.0, 2.0)
    )
    double.set_state(
        *(
            np.concatenate([a, np.flip(b, along)], axis=along)
            for a, b in ((density, density), (velocity, reflected), (temperature, temperature))
        )
    )
    mass = box.interior[..., 0].sum()
    for _ in range(100):
        dt = 0.5 / box.max_rate()
        box.advance(dt)
        double.advance(dt)
    assert abs(box.interior[..., 0].sum() / mass - 1) < 1e-14
    assert np.array_equal(double.interior[:n, :n], box.interior)


def test_thermal_walls_keep_mass_heat_and_drag():
    walls = {
        f"{side}": {"kind": "maxwell", "accommodation": 1.0, "temperature": 4.0, "velocity": [0.0, 0.5, 0.0]}
        for side in ("x-lower", "x-upper")
    }
    rng = np.random.default_rng(7)
    fluid = system((40,), walls)
    density, _, temperature = random_fields(rng, 1, 40, 3)
    fluid.set_state(density, np.zeros((1, 40, 3)), temperature)
    mass, energy = density.sum(), fluid.interior[..., -1].sum()
    run(fluid, 1.0)
    assert abs(fluid.interior[..., 0].sum() / mass - 1) < 1e-14
    assert fluid.interior[..., -1].sum() > 1.2 * energy
    # drawn along by the walls, evenly from both sides, and not beyond their speed
    u = fluid.moments()[1][0, :, 1]
    assert u.max() < 0.5 and u[0] > 0.05 and u[-1] > 0.05 and u.min() > -1e-6


@pytest.mark.parametrize(
    ("cells", "grid", "sides"),
    [
        ((13,), (3, 1), "far-field"),
        ((14, 11), (2, 1), "periodic"),
        ((14, 11), (2, 3), "periodic"),
        ((14, 11), (4, 2), "mixed"),
    ],
)
def test_results_do_not_depend_on_the_decomposition(cells, grid, sides):
    if sides == "mixed":
        wall = {"kind": "maxwell", "accommodation": 0.5, "temperature": 2.0, "velocity": [0.0, 0.1, 0.0]}
        sides = {"x-lower": "specular", "x-upper": wall, "y-lower": "vacuum", "y-upper": "outflow"}
    rng = np.random.default_rng(8)
    job = make_job(cells, (0.0,) * len(cells), (1.0,) * len(cells), sides, 3, cooling=0.5)
    nx, ny = (*cells, 1)[:2]
    fields = rng.random((ny, nx)), rng.normal(size=(ny, nx, 3)), 10 ** (2 * rng.random((ny, nx)))

    def advance(fluid, domain):
        (i, j), (w, h) = domain.start, domain.local
        fluid.set_state(*(f[j : j + h, i : i + w] for f in fields))
        for _ in range(12):
            fluid.advance(0.5 / domain.maximum(fluid.max_rate())[0])

    domain = SerialDomain(job)
    whole = FluidSystem(job, domain)
    advance(whole, domain)
    blocks = Blocks(*grid)
    domains = [BlockDomain(job, blocks, rank) for rank in range(grid[0] * grid[1])]
    parts = [FluidSystem(job, domain) for domain in domains]
    threads = [threading.Thread(target=advance, args=pair) for pair in zip(parts, domains, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for part, domain in zip(parts, domains, strict=True):
        (i, j), (w, h) = domain.start, domain.local
        assert np.array_equal(part.interior, whole.interior[j : j + h, i : i + w])


def test_a_step_too_long_is_halved():
    """At 40 times the largest step one attempt loses positivity; what comes out is positive, mass exact."""
    rng = np.random.default_rng(9)
    fields = rng.random((16, 16)) ** 4, np.zeros((16, 16, 3)), 10 ** (4 * rng.random((16, 16)))
    fluid = system((16, 16))
    fluid.set_state(*fields)
    dt = 20.0 / fluid.max_rate()
    assert fluid._transport(dt) is not None
    fluid.set_state(*fields)
    fluid.advance(dt)
    density, _, temperature = fluid.moments()
    assert density.min() > 0 and temperature.min() > 0
    assert abs(density.sum() / fields[0].sum() - 1) < 1e-13


def test_a_lost_cell_is_named():
    fluid = system((8, 6))
    fluid.set_state(np.ones((6, 8)), np.zeros((6, 8, 3)), np.ones((6, 8)))
    fluid.interior[2, 5, -1] = np.nan
    with pytest.raises(FloatingPointError, match=r"\(5, 2\)"):
        fluid.advance(1e-3)
    fluid.interior[2, 5, -1] = -1.0
    with pytest.raises(FloatingPointError, match=r"\(5, 2\)"):
        fluid.advance(1e-3)


def test_refused():
    with pytest.raises(ValueError, match="3 cells"):
        system((8, 2))
    with pytest.raises(ValueError, match="velocity dimensions"):
        system((8, 8), d=1)
    with pytest.raises(ValueError, match="no boundary"):
        system((8,), "sticky")
    fluid = system((8,), "far-field")
    with pytest.raises(ValueError, match="set_state"):
        fluid.fill_ghosts()
