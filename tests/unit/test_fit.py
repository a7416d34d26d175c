"""Whether a state fits the velocity grid: the rule, and that a check and a run's start come to the same answer."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rvm_mpi import Simulation
from rvm_mpi.advice import start, velocity_grid
from rvm_mpi.commands.main import main
from rvm_mpi.grid.velocity import VelocityGrid
from rvm_mpi.job.job import Job, JobError
from rvm_mpi.kinetic import realisable
from rvm_mpi.step import fit
from rvm_mpi.step.failure import NumericalFailure


@given(points=st.integers(4, 40), width=st.floats(1, 20), where=st.floats(-0.999, 0.999))
def test_the_rule_is_that_of_the_discrete_gaussian(points, width, where):
    nodes = VelocityGrid.create((points,), (width,)).nodes[0]
    assert np.array_equal(nodes[:points], fit.nodes_of(points, width))
    mean = where * nodes[points - 1]
    h = nodes[1] - nodes[0]
    kernels = realisable.smallest_variance.py_func(nodes, points, mean) + realisable.ROOM * h * h
    least = float(fit.least_variance(points, width, np.array(mean)))
    assert kernels < least <= kernels + 2e-12 * h * h
    assert least <= fit.holds_anywhere(h) * (1 + 1e-12)


def test_a_mean_beyond_the_nodes_fits_nowhere():
    assert fit.least_variance(8, 7.0, np.array([-6.2, 0.0, 6.125])).tolist()[0::2] == [np.inf, np.inf]


def make(**tables):
    return Job.from_dict(
        {
            "space": {"cells": [5]},
            "velocity": {"points": [12, 12], "half_width": 6.0},
            "collision": {"operator": "es-bgk", "knudsen": 0.1},
            "initial": {"state": "uniform"},
            "time": {"end": 0.5, "max_steps": 1},
        }
        | tables,
        "job",
    )


BOLTZMANN = {"operator": "boltzmann", "knudsen": 1.0, "restitution": 1.0, "exponent": 0.0}
REFUSED = {
    "flow along x, cold across it": make(
        velocity={"points": [32, 12, 12], "half_width": [6.0, 5.5, 5.5]},
        initial={"state": "uniform", "velocity": [3.872983346207417, 0, 0]},
    ),
    "colder along one axis": make(
        scaling={"kind": "none"}, initial={"state": "uniform", "stress": [[1.0, 0.0], [0.0, 0.2]]}
    ),
    "two directions nearly one": make(
        velocity={"points": [15, 11], "half_width": [9.74, 9.57]}, scaling={"kind": "none"},
        initial={
            "state": "uniform", "velocity": [0.831, 0.0027], "stress": [[0.4143, 0.1168], [0.1168, 0.03499]],
        },
    ),
    "the fastest cells of a wave": make(initial={"state": "wave", "velocity_amplitude": [4.0, 0.0]}),
    "one half of a Riemann problem": make(
        initial={
            "state": "riemann",
            "left": {"density": 1.0, "temperature": 1.0},
            "right": {"density": 1.0, "temperature": 1.0, "velocity": [0.0, 4.0]},
        }
    ),
    "sampled too coarsely": make(
        space={"cells": []}, collision=BOLTZMANN, velocity={"points": [6, 6], "half_width": 7.0},
        initial={"state": "bkw"}, scaling={"kind": "none"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_run_refuses_a_check_refuses(name, tmp_path, capsys):
    path = tmp_path / "job.toml"
    path.write_text(REFUSED[name].to_toml())
    said = []
    for command in (["check", str(path)], ["run", str(path), "--output", str(tmp_path / "run")]):
        assert main(command) == 2
        said.append(capsys.readouterr().err)
        assert said[-1].count("\n") == 1 and said[-1].startswith("rvm: velocity")
    assert said[0] == said[1] and not (tmp_path / "run").exists()
    with pytest.raises(JobError, match="velocity"):
        Simulation(REFUSED[name])


def test_the_points_that_a_refusal_names_will_do():
    job = REFUSED["flow along x, cold across it"]
    with pytest.raises(JobError, match=r"allowed such as \[32, 15, 15\].*cell \(0, 0\).*along y .* needs 0.1667"):
        velocity_grid.check_box(job)
    assert Simulation(make(velocity={"points": [32, 15, 15], "half_width": [6.0, 5.5, 5.5]}, initial=job.initial))


def test_a_library_users_state_is_held_to_the_same_rule():
    with pytest.raises(JobError, match=r"too few for the initial state .* cell \(3, 0\)"):
        Simulation(make(), lambda x, y: (1.0, np.where(abs(x[..., None] - 0.7) < 0.1, [9.0, 0.0], 0.0), 1.0))
    for sick in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(JobError, match=r"no positive, finite density and temperature in cell \(2, 0\)"):
            Simulation(make(), lambda x, y, sick=sick: (np.where(abs(x - 0.5) < 0.1, sick, 1.0), 0.0, 1.0))


SPEED, TEMPERATURE = st.floats(-2.5, 2.5), st.floats(0.1, 3)


@st.composite
def small_jobs(draw):
    """A job of a few cells and velocities, some of which cannot start."""
    d = draw(st.integers(1, 3))
    n = draw(st.integers(0, min(d, 2)))
    velocity = st.lists(SPEED, min_size=d, max_size=d)
    space = {"cells": [draw(st.integers(3, 4)) for _ in range(n)]}
    kinds = st.sampled_from(["periodic", "specular", "vacuum", "outflow", "far-field", "diffuse"])
    if n:
        space["boundary"] = {axis: draw(kinds) for axis in "xy"[:n]}
    law = {"relaxation": {"coefficient": 2.0}}
    operator = draw(st.sampled_from(["none", "es-bgk", "granular-es-bgk", "boltzmann"]))
    collision = {"operator": operator} | ({} if operator == "none" else {"knudsen": 0.1})
    if operator in ("granular-es-bgk", "boltzmann"):
        collision["restitution"] = draw(st.sampled_from([0.9, 1.0]))
    if operator == "boltzmann":
        collision |= {"exponent": draw(st.sampled_from([0.0, 1.0])), "coarse": True}
    elif operator != "none":
        collision |= law
    same = operator == "boltzmann"
    width = draw(st.floats(2.5, 9)) if same else [draw(st.floats(2.5, 9)) for _ in range(d)]
    states = [{"state": "uniform", "velocity": draw(velocity), "temperature": draw(TEMPERATURE)}]
    factor = np.array(draw(st.lists(st.floats(-1, 1), min_size=d * d, max_size=d * d))).reshape(d, d)
    stress = factor @ factor.T + 0.1 * np.eye(d)
    states.append({"state": "uniform", "velocity": draw(velocity), "stress": (0.5 * (stress + stress.T)).tolist()})
    if n:
        side = [{"density": 1.0, "temperature": draw(TEMPERATURE), "velocity": draw(velocity)} for _ in range(2)]
        states.append({"state": "riemann", "left": side[0], "right": side[1]})
        states.append({"state": "wave", "velocity_amplitude": draw(velocity), "temperature_amplitude": 0.5})
        states.append({"state": "random-density", "temperature": draw(TEMPERATURE)})
        states.append({"state": "temperature-disc", "radius": 0.3, "outer": draw(TEMPERATURE)})
    elif same and d > 1:
        states.append({"state": "two-gaussians", "sigma": draw(st.floats(0.2, 2))})
        if collision["exponent"] == 0.0 and collision["restitution"] == 1.0:
            states.append({"state": "bkw"})
    return {
        "space": space,
        "velocity": {"points": [draw(st.integers(5, 14)) for _ in range(d)], "half_width": width},
        "scaling": {"kind": draw(st.sampled_from(["none", "macroscopic", "kinetic"]))},
        "collision": collision,
        "initial": draw(st.sampled_from(states)),
        "time": {"end": 1e-3, "max_steps": 1},
        "fluid": {"enabled": True},
    }


def outcome(tables):
    """How a check and a start of one job end: refused or not."""
    try:
        job = Job.from_dict(tables, "job")
    except JobError:
        return "no job"
    try:
        start.check_start(job, 1)
        checked = ""
    except JobError as error:
        checked = str(error)
    try:
        simulation = Simulation(job)
    except JobError as error:
        assert checked, f"valid, but refused at its start: {error}"
        return "refused by both"
    except NumericalFailure as error:
        assert checked, f"valid, but failed at its start: {error}"
        return "refused by the check, fails"
    if not checked:
        assert np.isfinite(simulation.kinetic.rate)
        return "valid, starts"
    # the box is held to three thermal speeds before anything else: for a run of the command, not of the library
    assert "half_width: too small" in checked or "too small for the gas" in checked, checked
    return "box too small for the command"


RULES = {"deadline": None, "derandomize": True, "database": None,
         "suppress_health_check": [HealthCheck.too_slow, HealthCheck.filter_too_much]}  # fmt: skip


def try_jobs(count):
    seen: dict[str, int] = {}

    @settings(max_examples=count, **RULES)
    @given(small_jobs())
    def each(tables):
        how = outcome(tables)
        seen[how] = seen.get(how, 0) + 1

    each()
    print(seen)
    assert seen.get("valid, starts", 0) > count // 20 and seen.get("refused by both", 0) > count // 20


@pytest.mark.timeout(300)
def test_a_valid_job_starts_and_one_that_does_not_is_not_valid():
    try_jobs(100)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_thousand_valid_jobs_start():
    try_jobs(1500)
