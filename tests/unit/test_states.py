"""Initial states: what they are; no cell depends on the block, nor a smooth state on the grid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rvm_mpi.commands.check import describe_states
from rvm_mpi.job.initial import INITIAL_STATES
from rvm_mpi.job.job import Job, JobError
from rvm_mpi.states import STATES, macroscopic_state

SIDES = {
    "left": {"density": 1, "temperature": 2, "velocity": [1, 0, 0]},
    "right": {"density": 0.125, "temperature": 0.8},
}
EXAMPLES = [
    {
        "state": "uniform",
        "density": 2,
        "velocity": [1, 2, 3],
        "stress": [[1, 0.5, 0], [0.5, 2, 0], [0, 0, 3]],
    },
    {"state": "random-density", "seed": 3, "low": 0.2},
    {"state": "random-density", "seed": 3, "correlation_length": 0.11},
    {"state": "temperature-disc", "radius": 0.3},
    {"state": "riemann", **SIDES},
    {"state": "riemann", "direction": "y", **SIDES},
    {"state": "wave", "mode": [2, -1], "density_amplitude": 0.3, "velocity_amplitude": [0, 0.1, 0]},
]


def make(initial, cells=(23, 17), velocities=3, **space):
    return Job.from_dict(
        {
            "space": {"cells": list(cells), **space},
            "velocity": {"points": [16] * velocities},
            "collision": {"operator": "none"},
            "initial": initial,
            "time": {"end": 1.0},
        }
    )


def whole(job):
    nx, ny = (*job.space.cells, 1, 1)[:2]
    return macroscopic_state(job, 0, nx, 0, ny)


@pytest.mark.parametrize("initial", EXAMPLES, ids=[str(e)[:60] for e in EXAMPLES])
@settings(deadline=None, max_examples=30)
@given(data=st.data())
def test_a_cell_does_not_depend_on_the_block(initial, data):
    job = make(initial)
    nx, ny = job.space.cells
    i0 = data.draw(st.integers(0, nx - 1))
    i1 = data.draw(st.integers(i0 + 1, nx))
    j0 = data.draw(st.integers(0, ny - 1))
    j1 = data.draw(st.integers(j0 + 1, ny))
    for part, all_of_it in zip(macroscopic_state(job, i0, i1, j0, j1), whole(job), strict=True):
        assert np.array_equal(part, all_of_it[j0:j1, i0:i1])


@pytest.mark.parametrize("cells", [(), (12,), (12, 9)])
@pytest.mark.parametrize("velocities", [2, 3])
def test_shapes(cells, velocities):
    job = make({"state": "uniform"}, cells, velocities)
    nx, ny = (*cells, 1, 1)[:2]
    density, velocity, stress = whole(job)
    assert density.shape == (ny, nx)
    assert velocity.shape == (ny, nx, velocities)
    assert np.array_equal(stress, np.broadcast_to(np.eye(velocities), (ny, nx, velocities, velocities)))
    assert not velocity.any()
    assert (density == 1).all()


def test_anisotropic_gaussian():
    density, velocity, stress = whole(make(EXAMPLES[0]))
    assert (density == 2).all()
    assert (velocity == [1, 2, 3]).all()
    assert (stress == [[1, 0.5, 0], [0.5, 2, 0], [0, 0, 3]]).all()


def test_white_noise_is_uniform_and_uncorrelated():
    density = whole(make({"state": "random-density", "seed": 1, "low": 1, "high": 3}, (400, 300)))[0]
    count = density.size
    assert density.min() > 1
    assert density.max() < 3
    assert density.mean() == pytest.approx(2, abs=4 * np.sqrt(4 / 12 / count))
    assert density.var() == pytest.approx(4 / 12, rel=0.02)
    for axis in (0, 1):
        noise = density - density.mean()
        correlation = (noise * np.roll(noise, 1, axis)).mean() / noise.var()
        assert abs(correlation) < 4 / np.sqrt(count)


def test_white_noise_is_frozen():
    """The numbers themselves are part of the interface: a job must give the same gas for ever."""
    density = whole(make({"state": "random-density", "seed": 1}, (4, 3)))[0]
    frozen = [0.3035680343067587, 0.8487087496857769, 0.1561347780434731, 0.031106436954376204]
    assert density[0].tolist() == frozen
    assert density[1, 0] != density[0, 0]


@pytest.mark.parametrize("length", [0.0, 0.1])
def test_seeds_differ(length):
    first, second = (
        whole(make({"state": "random-density", "seed": seed, "correlation_length": length}))[0]
        for seed in (0, 1)
    )
    assert np.abs(first - second).max() > 0.1


@pytest.mark.parametrize("cells", [(20,), (20, 12)])
def test_smooth_noise_is_the_same_on_every_grid(cells):
    """A grid three times as fine has a cell centre at each of the coarse grid's."""
    initial = {"state": "random-density", "correlation_length": 0.1, "seed": 4}
    coarse = whole(make(initial, cells))[0]
    fine = whole(make(initial, [3 * n for n in cells]))[0]
    centres = fine[1::3, 1::3] if len(cells) == 2 else fine[:, 1::3]
    assert np.allclose(coarse, centres, rtol=0, atol=1e-12)


def test_smooth_noise_has_its_correlation_and_is_uniformly_distributed():
    from scipy.special import ndtri

    length, n = 0.05, 40
    fields = np.array(
        [
            whole(make({"state": "random-density", "correlation_length": length, "seed": s}, (n, n)))[0]
            for s in range(60)
        ]
    )
    assert fields.mean() == pytest.approx(0.5, abs=0.02)
    assert fields.var() == pytest.approx(1 / 12, rel=0.05)
    normal = ndtri(fields)
    for shift in (1, 2, 4):
        expected = np.exp(-((shift / n) ** 2) / (2 * length**2))
        for axis in (1, 2):
            assert (normal * np.roll(normal, shift, axis)).mean() == pytest.approx(expected, abs=0.05)


def test_disc_keeps_the_symmetries_of_the_square():
    for cells in (64, 50):  # 50: cell centres on the circle
        job = make({"state": "temperature-disc"}, (cells, cells), lower=[-1, -1])
        temperature = whole(job)[2][..., 0, 0]
        assert set(np.unique(temperature)) == {1.0, 100.0}
        for turned in (temperature[::-1], temperature[:, ::-1], temperature.T):
            assert np.array_equal(temperature, turned)
        inside = (temperature == 1).mean() * 4
        assert inside == pytest.approx(np.pi / 4, rel=0.02)


def test_disc_is_a_slab_in_one_dimension():
    job = make({"state": "temperature-disc", "radius": 0.5}, (8,), lower=[-1])
    assert whole(job)[2][0, :, 0, 0].tolist() == [100, 100, 1, 1, 1, 1, 100, 100]


def test_riemann():
    density, velocity, stress = whole(make({"state": "riemann", "position": 0.25, **SIDES}, (8,)))
    assert density[0].tolist() == [1, 1, *[0.125] * 6]
    assert velocity[0, :, 0].tolist() == [1, 1, *[0] * 6]
    assert stress[0, :, 1, 1].tolist() == [2, 2, *[0.8] * 6]
    density = whole(make({"state": "riemann", "direction": "y", **SIDES}, (8, 4)))[0]
    assert (density[:2] == 1).all()
    assert (density[2:] == 0.125).all()


def test_wave():
    initial = {
        "state": "wave", "density": 2, "density_amplitude": 0.5, "temperature_amplitude": -0.25,
        "velocity": [0, 0, 1], "velocity_amplitude": [0, 0.125, 0], "mode": [1, 2],
    }  # fmt: skip
    job = make(initial, (20, 12), lower=[-1, 2], upper=[3, 5])
    density, velocity, stress = whole(job)
    x = -1 + 4 * (np.arange(20) + 0.5) / 20
    y = 2 + 3 * (np.arange(12) + 0.5) / 12
    shape = np.cos(2 * np.pi * ((x[None] + 1) / 4 + 2 * (y[:, None] - 2) / 3))
    assert np.allclose(density, 2 + 0.5 * shape, rtol=0, atol=1e-14)
    assert np.allclose(velocity[..., 1], 0.125 * shape, rtol=0, atol=1e-14)
    assert (velocity[..., 2] == 1).all()
    assert np.allclose(stress[..., 0, 0], 1 - 0.25 * shape, rtol=0, atol=1e-14)


def test_states_of_the_boltzmann_operator():
    job = Job.from_dict(
        {
            "space": {"cells": []},
            "velocity": {"points": [32, 32], "half_width": 9},
            "collision": {"operator": "boltzmann", "knudsen": 1, "restitution": 0.8},
            "initial": {"state": "two-gaussians"},
            "time": {"end": 1.0},
        }
    )
    density, velocity, stress = whole(job)
    rng = np.random.default_rng(0)
    sample = np.sqrt(0.5) * (rng.standard_normal((400_000, 2)) + rng.choice([-1, 1], (400_000, 1)))
    assert np.allclose(stress[0, 0], np.cov(sample.T), atol=0.01)
    assert np.trace(stress[0, 0]) / 2 == pytest.approx(1)
    assert density.item() == 1
    assert not velocity.any()


# --- from a run


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Stand in for a run directory: what `open_run` gives for a wave on (12, 10) cells at two times."""
    xarray = pytest.importorskip("xarray")
    (tmp_path / "fields.h5").write_bytes(b"")
    wave = {"state": "wave", "mode": [1, 1], "density_amplitude": 0.5, "velocity_amplitude": [0.3, 0, 0]}
    job = make(wave, (12, 10))
    density, velocity, stress = whole(job)
    dataset = xarray.Dataset(
        {
            "kinetic_density": (("time", "y", "x"), np.array([density, 2 * density])),
            "kinetic_velocity": (("time", "y", "x", "component"), np.array([velocity, velocity])),
            "kinetic_temperature": (("time", "y", "x"), np.array([stress[..., 0, 0]] * 2)),
        },
        {"time": [0.0, 0.5], "x": (np.arange(12) + 0.5) / 12, "y": (np.arange(10) + 0.5) / 10},
    )
    from rvm_mpi.output import read

    monkeypatch.setattr(read, "open_run", lambda path: dataset)
    return str(tmp_path), (density, velocity, stress)


def test_from_run_on_the_same_grid_is_the_run(run):
    path, (density, velocity, stress) = run
    first = whole(make({"state": "from-run", "run": path, "time": 0}, (12, 10)))
    last = whole(make({"state": "from-run", "run": path}, (12, 10)))
    assert np.array_equal(first[0], density)
    assert np.array_equal(last[0], 2 * density)
    assert np.array_equal(last[1], velocity)
    assert np.array_equal(last[2], stress)


@pytest.mark.parametrize("cells", [(24, 30), (6, 5), (7, 11)])
def test_from_run_keeps_mass_momentum_and_energy(run, cells):
    path, (density, velocity, stress) = run

    def integrals(rho, u, theta):
        energy = 0.5 * rho * (np.trace(theta, axis1=-2, axis2=-1) + (u**2).sum(-1))
        return np.array([rho.mean(), (rho[..., None] * u).mean((0, 1))[0], energy.mean()])

    there = integrals(2 * density, velocity, stress)
    here = integrals(*whole(make({"state": "from-run", "run": path}, cells)))
    assert np.allclose(here, there, rtol=1e-13, atol=1e-15)


def test_from_run_cut_to_blocks(run):
    path, _ = run
    job = make({"state": "from-run", "run": path}, (7, 11))
    for part, all_of_it in zip(macroscopic_state(job, 2, 5, 3, 9), whole(job), strict=True):
        assert np.array_equal(part, all_of_it[3:9, 2:5])


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({"time": 0.3}, "no snapshot at initial.time (value 0.3; allowed 0.0, 0.5)"),
        ({"upper": [2, 1]}, "covers 0 to 1 along x, this job's domain is 0 to 2"),
        ({"cells": (12,)}, "does not fit this job: it has 2 space"),
        ({"velocities": 2}, "and 3 velocity dimensions"),
    ],
)
def test_from_run_that_does_not_fit(run, changes, wrong):
    path, _ = run
    initial = {"state": "from-run", "run": path}
    if "time" in changes:
        initial["time"] = changes.pop("time")
    job = make(initial, **{"cells": (12, 10), **changes})
    with pytest.raises(JobError) as caught:
        whole(job)
    assert wrong in str(caught.value)


def test_every_state_of_the_schema_can_be_made_and_is_described():
    assert set(STATES) == set(INITIAL_STATES)
    text = "\n".join(describe_states())
    for name, model in INITIAL_STATES.items():
        assert f"{name}: " in text
        for key in model.model_fields:
            assert key == "state" or f"    {key}: " in text
