"""Estimates before a run, against direct computation and closed formulas."""

import time
from math import ceil, inf, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rvm_mpi import kinetic_theory, time_limits
from rvm_mpi.advice import duration, first_step, initial, memory, physics, velocity_grid
from rvm_mpi.collisions.weights import Rows
from rvm_mpi.commands import bench
from rvm_mpi.grid.domain import aligned
from rvm_mpi.job.job import Job, JobError
from rvm_mpi.kinetic import drift
from rvm_mpi.simulation import Simulation


def make(initial=None, cells=(64, 64), points=(24, 24, 8), half_width=7.0, collision=None, **tables):
    return Job.from_dict(
        {
            "space": {"cells": list(cells), **tables.pop("space", {})},
            "velocity": {"points": list(points), "half_width": half_width},
            "collision": collision or {"operator": "granular-es-bgk", "knudsen": 0.01, "restitution": 0.99},
            "initial": initial or {"state": "uniform"},
            "time": {"end": 30.0, **tables.pop("time", {})},
            **tables,
        }
    )


ELASTIC = {"operator": "es-bgk", "knudsen": 0.05, "relaxation": {"coefficient": 2.0, "temperature_power": 0}}


# --- the velocity grid


@given(points=st.integers(4, 40), width=st.floats(1, 20), where=st.floats(-0.9, 0.9), data=st.data())
def test_no_positive_numbers_on_the_nodes_are_colder(points, width, where, data):
    h = 2 * width / points
    nodes = (2 * np.arange(points) + 1 - points) * h / 2
    mean = where * nodes[-1]
    least = velocity_grid.least_temperature(points, width, mean)
    below = int(np.clip(np.floor((mean - nodes[0]) / h), 0, points - 2))
    share = (mean - nodes[below]) / h
    attained = (1 - share) * (nodes[below] - mean) ** 2 + share * (nodes[below + 1] - mean) ** 2
    assert least == pytest.approx(attained, abs=1e-9 * h**2)
    # any pair of nodes around the mean, and so any mixture of pairs, is at least as warm
    left = data.draw(st.integers(0, below))
    right = data.draw(st.integers(below + 1, points - 1))
    assert (mean - nodes[left]) * (nodes[right] - mean) >= least - 1e-9 * h**2


def test_the_coarse_direction_of_test_4():
    assert velocity_grid.least_temperature(8, 7.0) == pytest.approx(0.765625)
    assert velocity_grid.least_temperature(9, 7.0) == pytest.approx(0, abs=1e-12)
    assert velocity_grid.least_temperature(8, 7.0, 6.9) == inf
    assert velocity_grid.smallest_temperature(make()) == pytest.approx((2 * (7 / 24) ** 2 + 0.765625) / 3)
    # the figures of the sampled Gaussian on this grid: 4 % too warm at T_g = 1, 12 % at 0.8
    assert velocity_grid.sampled_temperature(8, 7.0, 1.0) == pytest.approx(1.04, abs=0.005)
    assert velocity_grid.sampled_temperature(8, 7.0, 0.8) / 0.8 == pytest.approx(1.12, abs=0.005)


@pytest.mark.parametrize(("points", "width"), [(8, 7.0), (16, 7.0), (24, 7.0), (9, 5.0)])
def test_sampling_limit_is_where_the_error_passes_one_percent(points, width):
    limit = velocity_grid.sampling_limit(points, width)
    assert abs(velocity_grid.sampled_temperature(points, width, 1.02 * limit) / (1.02 * limit) - 1) < 0.01
    assert abs(velocity_grid.sampled_temperature(points, width, 0.95 * limit) / (0.95 * limit) - 1) > 0.01


def test_largest_mach_leaves_the_smallest_temperature():
    job = make()
    d, mach = 3, velocity_grid.largest_mach(job)
    temperature = 1.0
    speed = mach * sqrt((d + 2) / d * temperature)
    omega2 = temperature + speed**2 / d
    assert temperature / omega2 == pytest.approx(velocity_grid.smallest_temperature(job))
    assert velocity_grid.largest_mach(make(points=(25, 25, 25))) > 1e6


# --- does the state fit the box


@pytest.mark.parametrize(
    "job",
    [
        make(),
        make({"state": "temperature-disc"}, collision=ELASTIC),
        make({"state": "uniform", "velocity": [1, 0, 0]}, points=(24, 24, 9)),
        make({"state": "uniform", "temperature": 1e6, "velocity": [1e3, 0, 0]}, points=(24, 24, 10)),
        make(scaling={"kind": "none"}, half_width=8, points=(24, 24, 10)),
        make(
            {
                "state": "riemann",
                "left": {"density": 1, "temperature": 1},
                "right": {"density": 1, "temperature": 50},
            }
        ),
    ],
)
def test_states_that_fit(job):
    velocity_grid.check_box(job)


@pytest.mark.parametrize(
    ("job", "wrong"),
    [
        (make({"state": "temperature-disc"}, scaling={"kind": "none"}), "at least 30.0 along x"),
        (make({"state": "uniform", "velocity": [0, 5, 0]}, scaling={"kind": "none"}), "at least 8.0 along y"),
        (make(half_width=[7, 7, 2]), "at least 3.0 along z"),
        (make({"state": "uniform", "velocity": [9, 0, 0]}), "too few for the initial state"),
        (make({"state": "uniform", "temperature": 0.2}, scaling={"kind": "none"}), "needs 0.2"),
        (
            make(
                scaling={"kind": "none"}, space={"boundary": {"x": {"kind": "maxwell", "temperature": 100}}}
            ),
            "too small for the gas from x-lower",
        ),
    ],
)
def test_states_that_do_not_fit(job, wrong):
    with pytest.raises(JobError) as caught:
        velocity_grid.check_box(job)
    assert wrong in str(caught.value)
    assert str(caught.value).startswith("velocity.")


# --- steps


def test_first_step_of_test_4_is_set_by_transport():
    first = first_step.first_step(make({"state": "random-density"}, scaling={"kind": "macroscopic"}))
    assert first.dt == first.later == pytest.approx(0.5 / (2 * 7 * 64))
    assert "transport" in first.limit
    assert first.drift_rate == 0


def test_kinetic_scaling_heats_a_nearly_empty_cell_at_once():
    """A cell of density rho between full ones: d ln omega/dt = sqrt(T / 2 pi) (1 - rho) / (d rho dx)."""
    rho, cells = 0.001, 16
    initial = {"state": "riemann", "position": 1 / 16, "left": {"density": rho, "temperature": 1}}
    job = make({**initial, "right": {"density": 1, "temperature": 1}}, cells=(cells,), collision=ELASTIC)
    first = first_step.first_step(job)
    growth = cells * 2 / sqrt(2 * pi) * ((1 - rho) * 4 / 3 - (1 - rho)) / (2 * rho)
    assert first.growth_rate == pytest.approx(growth * (12 + 12 + 4), rel=1e-12)
    # one cell of sixteen: its drift is best taken in as many substeps as are allowed
    assert first.dt == pytest.approx(0.5 / (first.growth_rate / 16 + 7 * cells), rel=1e-12)
    assert "drift" in first.limit
    assert first.later == pytest.approx(0.5 / (7 * cells))


def test_first_step_against_a_loop_over_cells():
    """The definition: dt = cfl / max of sum omega V/dx + share sum |a|max/h, a = (xi . grad omega) xi.

    The share is the one of 1, 1/4, 1/16 that takes least time where a substep of a cell's drift costs 0.3 of its stage.
    """
    wave = {"state": "wave", "mode": [1, 1], "temperature_amplitude": 0.9, "velocity": [0.5, 0, 0]}
    job = make(
        wave, cells=(12, 10), points=(16, 12, 10), half_width=[7, 6, 5], collision=ELASTIC,
        scaling={"kind": "macroscopic"},
    )  # fmt: skip
    start = initial.start_fields(job)
    omega = np.sqrt(start.temperature + 0.25 / 3)
    cells = []
    for j in range(10):
        for i in range(12):
            slope_x = (omega[j, (i + 1) % 12] - omega[j, i - 1]) / (2 / 12)
            slope_y = (omega[(j + 1) % 10, i] - omega[j - 1, i]) / (2 / 10)
            stretch = 7 * abs(slope_x) + 6 * abs(slope_y)
            drift = sum(stretch * width / (2 * width / n) for width, n in ((7, 16), (6, 12), (5, 10)))
            cells.append((omega[j, i] * (7 * 12 + 6 * 10), drift))
    costs = {}
    for share in (1.0, 0.25, 0.0625):
        dt = 0.5 / max(transport + share * drift for transport, drift in cells)
        most = 1.05 * 0.5
        substeps = [ceil(dt * drift / 0.5) if dt * (transport + drift) > most else 0 for transport, drift in cells]
        costs[(120 + 0.3 * sum(substeps)) / dt] = dt
    assert first_step.first_step(job).dt == pytest.approx(costs[min(costs)], rel=1e-12)


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_drift_of_a_granular_boltzmann_gas_is_what_its_run_measures(speed):
    """omega follows all of the energy, of which a moving gas cools a part only."""
    job = make(
        {"state": "uniform", "velocity": [speed, 0.0]}, cells=(), points=(36, 36), half_width=8.0,
        collision={"operator": "boltzmann", "knudsen": 0.1, "restitution": 0.8, "penalise": True},
        scaling={"kind": "kinetic"},
    )  # fmt: skip
    stepper = Simulation(job).kinetic
    stepper.first_stage(0.0)
    cells, _, _ = first_step._cell_rates(job, initial.start_fields(job))
    assert cells.drift == pytest.approx(stepper.cell_rates().drift, rel=0.05)
    assert cells.answering == pytest.approx(stepper.cell_rates().answering, rel=0.05)


def test_which_limit_binds():
    disc = make({"state": "temperature-disc"}, collision=ELASTIC, space={"lower": [-1, -1]})
    assert "drift" in first_step.first_step(disc).limit
    homogeneous = first_step.first_step(make(cells=()))
    assert "cooling" in homogeneous.limit
    assert homogeneous.dt == pytest.approx(0.1 / (2 * make().collision.cooling))
    assert first_step.first_step(make(time={"dt": 0.01})).limit == "time.dt"
    assert "time.end" in first_step.first_step(make(cells=(), collision=ELASTIC)).limit
    unscaled = first_step.first_step(make(cells=(), scaling={"kind": "none"}, time={"cfl": 0.01}))
    assert "drift" in unscaled.limit


def test_steps_of_a_cooling_gas_follow_haffs_law():
    """Steps grow like 1/omega: sum them one by one."""
    job = make(cells=(64,), time={"end": 3.0})
    dt, cooling, t, count = first_step.first_step(job).dt, job.collision.cooling, 0.0, 0
    while t < 3.0:
        t += dt * (1 + cooling * t)
        count += 1
    assert duration.steps(job) == pytest.approx(count, rel=0.01)
    assert duration.steps(make(time={"end": 3.0, "max_steps": 7})) == 7
    assert duration.steps(make(collision=ELASTIC, cells=(64,))) == pytest.approx(30 * 7 * 64 / 0.5)


#: a stage with the default's drift over one with Van Leer's
DEFAULT = duration.STAGE_WITH_DRIFT["maxwellian"]


def stages_of(job, cells, ratio):
    """Seconds of ten steps of two stages on two cores with a triad of 1 ns, `ratio` times that a phase-space cell."""
    return 10 * (duration.SECONDS_PER_STEP + 2 * cells * ratio * DEFAULT * duration.STEP_PER_STAGES * 1e-9 / 2)


def test_run_time_counts_cells_stages_and_ranks():
    job = make(cells=(64,), time={"max_steps": 10})
    assert duration.run_seconds(job, 2, 1e-9) == pytest.approx(stages_of(job, 64 * 24 * 24 * 8, 3.5))
    large = make(cells=(64,), points=(32, 32, 32), time={"max_steps": 10})
    assert duration.run_seconds(large, 2, 1e-9) == pytest.approx(stages_of(large, 64 * 32**3, 4.5))
    line = make(cells=(64,), points=(24,), time={"max_steps": 10}, collision={"operator": "none"})
    # in one velocity dimension a node takes the room of eight
    assert duration.run_seconds(line, 2, 1e-9) == pytest.approx(stages_of(line, 64 * 24 * 8, 3.5))
    positive = make(cells=(64,), time={"max_steps": 10}, scheme={"drift": "seventh-order-positive"})
    expected = stages_of(positive, 64 * 24 * 24 * 8, 3.5 * 1.75 / DEFAULT)
    assert duration.run_seconds(positive, 2, 1e-9) == pytest.approx(expected)


def test_every_reconstruction_has_a_cost():
    assert set(duration.STAGE_WITH_DRIFT) == set(drift.RECONSTRUCTIONS)


def test_the_triad_is_that_of_bench():
    """The same traffic: ten times more or less would be another unit or another loop, whatever the day."""
    arrays = [aligned((bench.TRIAD_SIZE,)) for _ in range(3)]
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        bench._triad(*arrays, 2.0)
        times.append((time.perf_counter() - begin) / bench.TRIAD_SIZE)
    assert 0.1 < duration.triad_seconds() / min(times) < 10


def pairs_of_modes(largest):
    """Pairs {l, m} of modes -largest..largest with |l + m| <= largest and l + m after zero, by counting."""
    modes = np.stack(np.meshgrid(*[np.arange(-largest, largest + 1)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    total = modes[:, None] + modes[None, :]
    kept = (np.abs(total) <= largest).all(axis=2)
    after = (total[..., 0] > 0) | ((total[..., 0] == 0) & (total[..., 1] > 0))
    return int(np.triu(kept & after).sum())


@pytest.mark.parametrize(("cells", "ranks", "counted"), [((), 1, 8), ((12,), 1, 16), ((30,), 2, 16), ((9, 4), 1, 40)])
def test_run_time_of_the_boltzmann_operator(cells, ranks, counted):
    """Ten operations a pair of modes, in eight cells at once."""
    boltzmann = {"operator": "boltzmann", "knudsen": 1, "restitution": 0.9}
    job = make(cells=cells, points=(10, 10), half_width=7, collision=boltzmann, time={"max_steps": 1})
    work = 10 * pairs_of_modes(4) / duration.OPERATIONS_PER_SECOND + 100 * duration.SECONDS_PER_NODE
    assert duration.operator_seconds(job, ranks) == pytest.approx(counted * work)
    stage = int(np.prod(cells)) * 10 * 16 * 3.5e-9 * DEFAULT * duration.STEP_PER_STAGES / ranks
    rest = duration.SECONDS_PER_STEP + 2 * stage
    assert duration.run_seconds(job, ranks, 1e-9) == pytest.approx(2 * counted * work + rest)
    assert duration.operator_seconds(make(), 1) == 0


# --- memory


def test_memory_of_g_is_two_ghosted_copies():
    assert memory.memory(make(), 1).g == 2 * 8 * 68 * 68 * 4608
    assert memory.memory(make(), 2).g == 2 * 8 * 68 * 36 * 4608
    assert memory.memory(make(cells=(64,)), 1).g == 2 * 8 * 68 * 4608
    assert memory.memory(make(cells=()), 1).g == 2 * 8 * 4608
    assert memory.cell_block((24, 24, 8)) == 4608
    assert memory.cell_block((5, 3, 3)) == 5 * 16
    assert memory.cell_block((10,)) == 10 * 8
    with pytest.raises(JobError, match="cannot share"):
        memory.memory(make(), 5000)


# --- physics


def test_physics_of_hard_spheres():
    job = make({"state": "uniform", "density": 2.0, "temperature": 4.0})
    gas = physics.physics(job)
    path = 0.01 / (sqrt(2) * pi * 2.0)  # of unit diameter
    assert gas.mean_free_path.mean == pytest.approx(path)
    assert gas.collision_time.mean == pytest.approx(path / sqrt(8 * 4 / pi))
    assert gas.cells_per_mean_free_path == pytest.approx(64 * path)
    assert gas.knudsen == pytest.approx(path)
    assert 1 / (1 + job.collision.cooling * 4.0 * gas.haff_time) ** 2 == pytest.approx(0.25)


def test_means_are_those_of_the_gas_not_of_empty_cells():
    """Density uniform in (0, 1): the mean free path of the mean state, whatever the emptiest cell has."""
    gas = physics.physics(make({"state": "random-density"}))
    density = initial.start_fields(make({"state": "random-density"})).density
    path = 0.01 / (sqrt(2) * pi * density)
    assert gas.mean_free_path.mean == pytest.approx((density * path).sum() / density.sum(), rel=1e-12)
    assert gas.mean_free_path.mean == pytest.approx(gas.knudsen, rel=1e-12) == pytest.approx(0.0045, rel=0.02)
    assert gas.mean_free_path.high > 100 * gas.mean_free_path.mean
    assert gas.coarse == pytest.approx(density[path < 1 / 64].sum() / density.sum())
    assert density[path <= gas.shortest].sum() / density.sum() == pytest.approx(0.1, abs=0.001)


@pytest.mark.parametrize(
    ("boundary", "side"),
    [({}, 0.5), ({"x": "diffuse"}, 2.0), ({"y": "specular"}, 0.5), ({"x": "vacuum", "y": "specular"}, 0.5)],
)
def test_the_knudsen_number_is_that_of_the_gap_between_boundaries(boundary, side):
    job = make(cells=(16, 8), space={"upper": [2.0, 0.5], "boundary": boundary}, collision=ELASTIC)
    gas = physics.physics(job)
    assert gas.knudsen == pytest.approx(gas.mean_free_path.mean / side) and gas.length == side


@pytest.mark.parametrize("d", [1, 2, 3])
def test_mean_speed_by_sampling(d):
    v = np.random.default_rng(d).standard_normal((200_000, d)) * sqrt(1.7)
    speed = np.linalg.norm(v, axis=1)
    assert kinetic_theory.mean_speed(d, np.array(1.7)) == pytest.approx(
        speed.mean(), abs=4 * speed.std() / sqrt(len(v))
    )


def test_boltzmann_collision_frequency_by_sampling():
    """Loss rate of hard spheres in a Maxwellian: rho b |S| <|u|> / Knudsen number."""
    collision = {"operator": "boltzmann", "knudsen": 0.5, "restitution": 1, "cross_section": 0.3}
    job = make(cells=(), points=(32, 32, 32), collision=collision)
    v, w = np.random.default_rng(0).standard_normal((2, 200_000, 3)) * sqrt(1.7)
    expected = 2.0 * 0.3 * 4 * pi * np.linalg.norm(v - w, axis=1).mean() / 0.5
    assert time_limits.collision_frequency(job, np.array(2.0), np.array(1.7)) == pytest.approx(
        expected, rel=0.01
    )


def test_free_transport_has_no_collision_scales():
    assert physics.physics(make(collision={"operator": "none"})) is None


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.5, "0.5 s"), (100, "100 s"), (600, "10.0 min"), (7200, "2.0 h"), (2e5, "2.3 days")],
)
def test_durations_in_words(seconds, words):
    assert duration.duration_in_words(seconds) == words


def test_boltzmann_weights_that_do_not_fit_are_refused_with_what_would():
    """24^3 points take 16 MB of weights and eight times that while they are made: not in 100 MB."""
    job = make(
        cells=(), velocity={"points": [24, 24, 24]}, collision={"operator": "boltzmann", "knudsen": 1, "restitution": 1}
    )
    memory.check_weights(job)
    with pytest.raises(JobError, match=r"16\.3 MB.*allowed such as \[(20|18), (20|18), (20|18)\]"):
        memory.check_weights(job, available=100e6)


def test_boltzmann_weights_are_counted_once_a_node():
    """What a rank needs for itself shrinks with its share of the cells, the weights do not multiply."""
    job = make(
        cells=(12, 8),
        velocity={"points": [16, 16, 16]},
        collision={"operator": "boltzmann", "knudsen": 1, "restitution": 1},
    )
    one, four = memory.memory(job, 1), memory.memory(job, 4)
    weights = Rows.create((16, 16, 16)).weight_bytes
    assert one.weights == four.weights == weights
    assert one.operator - four.operator == 8 * 72 * 16**3
    assert one.total == one.g + one.fluxes + one.operator + one.fields + memory.LIBRARIES
    assert memory.memory(make()).weights == 0
