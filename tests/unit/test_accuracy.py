"""What viscosity and heat conduction are worth on a velocity grid: tables, verdicts, refusals and cures."""

import re
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import tomli_w

from benchmarks import grid_accuracy
from rvm_mpi.advice import accuracy, conduction, cooling_state
from rvm_mpi.advice.accuracy_tables import BOLTZMANN, DRIFT, HALF_WIDTHS, SPACINGS
from rvm_mpi.commands.main import main
from rvm_mpi.job.job import Job
from rvm_mpi.job.schema import Scheme
from tests.verification.cooling_state import cumulant
from tests.verification.kinetic_cases import run
from tests.verification.navier_stokes import conductivity

JOBS = sorted((Path(__file__).parents[2] / "jobs").glob("*.toml"))
WAVE = {
    "space": {"cells": [6]},
    "velocity": {"points": [16, 16, 16]},
    "scaling": {"kind": "none"},
    "fluid": {"enabled": False},
    "collision": {"operator": "boltzmann", "knudsen": 0.05, "restitution": 1.0},
    "initial": {"state": "wave", "temperature_amplitude": 0.02, "density_amplitude": -0.02},
    "time": {"end": 1.0, "max_steps": 2},
}


def write(path, **tables):
    path.write_text(tomli_w.dumps({**WAVE, **tables}))
    return str(path)


@pytest.mark.parametrize("points", [16, 20, 21])
def test_the_command_gives_the_table(points):
    _first, *found = grid_accuracy.measure_operator(2, points)
    for row, wanted in zip(found, BOLTZMANN[2][points], strict=True):
        np.testing.assert_allclose(row, wanted, rtol=2e-3, atol=1e-7)
    loss = grid_accuracy.measure_cooling(points)[0]
    np.testing.assert_allclose(loss, BOLTZMANN[1][points][0], rtol=1e-3)


def test_on_fine_grids_all_is_right():
    """First Sonine approximations are known in closed form; the integrals to what the Sonine series give."""
    first, viscosity, conduction, residue = grid_accuracy.measure_operator(2, 32)
    at = HALF_WIDTHS[2].index(8.0)
    np.testing.assert_allclose(first[:, at], 1.0, atol=1e-3)
    np.testing.assert_allclose([viscosity[at], conduction[at]], 1.0, atol=1e-3)
    assert abs(residue[at]) < 1e-5


@pytest.mark.parametrize("points", [16, 18, 20])
def test_what_never_relaxes_is_the_nyquist_modes(points):
    """They take no part in collisions: the table against their share of M xi_x (|xi|^2 - d - 2), by Fourier's sums."""
    for width, found in zip(HALF_WIDTHS[2], BOLTZMANN[2][points][2], strict=True):
        gas = grid_accuracy.Gas(2, points, [width], 1.0, 1.0)
        modes = np.fft.fftn((gas.maxwellian * gas.flux)[0])
        modes[np.ix_(*[[n for n in range(points) if n != points // 2]] * 2)] = 0.0
        share = gas.part(np.fft.ifftn(modes).real[None], gas.flux)[0]
        if 0.005 < abs(share) < 0.5:
            assert found == pytest.approx(share, rel=0.12)


def test_only_the_ratios_to_the_thermal_speed_count():
    for d, points, width in ((2, 20, 7.0), (3, 21, 6.3), (1, 24, 8.0)):
        here = accuracy.operator_worth((points,) * d, width, 1.0)
        there = accuracy.operator_worth((points,) * d, 3 * width, 9.0)
        assert (here.first, here.conductivity, here.residue) == pytest.approx(
            (there.first, there.conductivity, there.residue), rel=1e-9
        )


def test_coarser_is_never_taken_for_better():
    """Off the table a grid counts as infinitely wrong where it is narrow or coarse, and as right where it is fine."""
    assert accuracy.operator_worth((6, 6), 7.0, 1.0) == accuracy.OFF
    assert accuracy.operator_worth((32, 32, 32), 4.0, 1.0) == accuracy.OFF
    assert accuracy.operator_worth((24, 24), 7.0, 0.01) == accuracy.OFF
    assert accuracy.operator_worth((64, 64), 12.0, 1.0).error(True) < 0.01
    assert accuracy.operator_worth((24, 24, 16), 7.0, 1.0) == accuracy.operator_worth((16, 16, 16), 7.0, 1.0)


# --- what users see


def test_a_grid_that_conducts_wrongly_is_refused_with_a_cure_that_works(tmp_path, capsys):
    job, directory = write(tmp_path / "wave.toml"), tmp_path / "run"
    for command in (["check", job], ["run", job, "--output", str(directory)]):
        assert main(command) == 2
        line = capsys.readouterr().err
        assert line.startswith("rvm: velocity.points: too few for the Boltzmann operator (value [16, 16, 16], half_w")
        assert re.search(r"on 3\.[67]\d\d of the exact ones at T = 0.98., 3\d % of a heat flux never relaxes", line)
        assert line.endswith("or ask for it with collision.coarse = true\n") and line.count("\n") == 1
    assert not directory.exists()
    points = re.search(r"take (\d+) points a direction", line).group(1)
    assert "half_width" not in line.partition("take ")[2]  # the best one is 18 % off: no cure
    assert main(["check", job, "--set", f"velocity.points={[int(points)] * 3}"]) == 0
    assert "  warning" not in capsys.readouterr().out
    assert main(["check", job, "--set", "velocity.half_width=5.55"]) == 0
    assert "heat conduction 1.18" in capsys.readouterr().out
    assert main(["check", job, "--set", "collision.coarse=true"]) == 0
    assert re.search(r"heat conduction 3\.[67]\d\d of the exact ones", capsys.readouterr().out)


def test_a_box_too_narrow_names_the_half_width(tmp_path, capsys):
    job = write(tmp_path / "wave.toml", velocity={"points": [24, 24, 24], "half_width": 4.5})
    assert main(["check", job]) == 2
    line = capsys.readouterr().err
    assert line.startswith("rvm: velocity.half_width: too narrow for the Boltzmann operator (value 4.5")
    width = re.search(r"take half_width ([\d.]+) with these", line).group(1)
    assert main(["check", job, "--set", f"velocity.half_width={width}"]) == 0
    assert "  warning" not in capsys.readouterr().out


def test_a_run_says_once_what_its_grid_is_worth(tmp_path, capsys):
    job = write(tmp_path / "wave.toml", velocity={"points": [20, 20], "half_width": 7.0})
    assert main(["run", job, "--output", str(tmp_path / "run")]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "Boltzmann operator on this" in line]
    assert len(said) == 1 and "heat conduction 1.1" in said[0] and "take 21 points" in said[0]
    assert said[0] in (tmp_path / "run" / "run.log").read_text()
    assert main(["run", write(tmp_path / "fine.toml", velocity={"points": [32, 32], "half_width": 8.0}),
                 "--output", str(tmp_path / "fine")]) == 0  # fmt: skip
    assert "warning" not in capsys.readouterr().err


def test_a_gas_that_cools_out_of_its_grid_is_told_of():
    """In classical variables T falls from 1: the spacing grows in thermal speeds."""
    job = Job.from_dict({**WAVE, "velocity": {"points": [32, 32], "half_width": 8.0}})
    watched = accuracy.GridWatch(job)
    said = [watched.warnings((cold, 1.0), {"step": 3, "time": 0.5}) for cold in (1.0, 0.8, 0.6, 0.59, 0.2)]
    assert [len(lines) for lines in said] == [0, 0, 1, 0, 1]
    assert "at T = 0.6" in said[2][0] and said[2][0].endswith("in step 3 at t = 0.5")


def test_elastic_collisions_in_one_dimension_are_not_judged():
    """They exchange velocities and do nothing."""
    one = {"velocity": {"points": [8]}, "space": {"cells": []}, "initial": {"state": "uniform"}}
    accuracy.check_grid(Job.from_dict({**WAVE, **one}))
    granular = {"collision": {**WAVE["collision"], "restitution": 0.9}}
    with pytest.raises(accuracy.JobError, match="loss of energy"):
        accuracy.check_grid(Job.from_dict({**WAVE, **one, **granular}))


def test_without_space_no_heat_flows_and_viscosity_alone_counts():
    velocity = {"points": [16, 16], "half_width": 7.0}
    homogeneous = {"space": {"cells": []}, "initial": {"state": "two-gaussians"}, "velocity": velocity}
    accuracy.check_grid(Job.from_dict({**WAVE, **homogeneous}))
    with pytest.raises(accuracy.JobError):
        accuracy.check_grid(Job.from_dict({**WAVE, "velocity": velocity}))


def test_coarse_is_a_key_of_the_boltzmann_operator():
    with pytest.raises(accuracy.JobError, match=r'collision.coarse: not used by "es-bgk"'):
        Job.from_dict({**WAVE, "collision": {"operator": "es-bgk", "knudsen": 1.0, "coarse": True}})
    assert Job.from_dict(WAVE).collision.coarse is False


@pytest.mark.parametrize("path", JOBS, ids=lambda path: path.stem)
def test_shipped_jobs_stand(path):
    job = Job.from_file(path)
    accuracy.check_grid(job)
    assert accuracy.operator_warning(job) == ""


# --- the drift, and classical variables


def test_every_drift_is_in_the_table():
    assert set(DRIFT) == set(get_args(Scheme.model_fields["drift"].annotation))


@pytest.mark.parametrize(
    ("drift", "points"), [("van-leer", (20, 10)), ("maxwellian", (12, 16)), ("van-leer", (12, 24))]
)
def test_errors_of_the_directions_add_up(drift, points):
    exact = conductivity(0.01, 48, (16, 16), "none", drift, 1.0, 7.0)
    found = conductivity(0.01, 48, points, "kinetic", drift, 1.0, 7.0) / exact
    foretold = conduction.drift_worth(drift, [14 / n for n in points], 1.0)
    print(f"{drift}, {points}: {found:.4f}, foretold {foretold:.4f}")
    assert found == pytest.approx(foretold, abs=0.006)


def test_discrete_gaussians_in_classical_variables():
    """A wave decays by conduction over the enthalpy that flows, both of the discrete Gaussian."""
    points, half_width = 10, 7.5
    h = 2 * half_width / points
    nodes = (np.arange(points) + 0.5) * h - half_width
    widths = np.linspace(0.5, 2.0, 20001)
    weights = np.exp(-0.5 * nodes**2 / widths[:, None])
    at = np.argmin(abs(weights @ nodes**2 / weights.sum(1) - 1.0))
    enthalpy = (weights[at] @ nodes**4 / weights[at].sum()) / 3
    wave = conductivity(0.01, 64, (points,), "none", "van-leer", 1.0, half_width)
    wave /= conductivity(0.01, 64, (24,), "none", "van-leer", 1.0, 7.0)
    worth = conduction.gaussian_worth(points, half_width, 1.0, 1)
    print(f"wave {wave:.4f}, conduction {worth:.4f}, over the enthalpy {worth / enthalpy:.4f}")
    assert abs(worth - 1) > 0.1 and wave == pytest.approx(worth / enthalpy, rel=0.03)
    assert conduction.gaussian_worth(24, 7.0, 1.0, 3) == pytest.approx(1.0, abs=1e-5)
    assert conduction.gaussian_worth(8, 7.0, 0.4, 1) == np.inf


def test_a_viscosity_that_is_wrong_is_warned_of_too(monkeypatch):
    """No grid of the table has one by its drift: with a table that does, the direction that is worst counts."""
    tables = {"scaling": {"kind": "kinetic"}, "collision": {"operator": "es-bgk", "knudsen": 0.05}}
    job = Job.from_dict({**WAVE, **tables, "velocity": {"points": [24, 24, 12]}})
    assert "viscosity 1.000" in dict(conduction.describe(job))["heat conduction"]
    along, across, shear = DRIFT["maxwellian"]
    thicker = tuple(1.05 if h > 1.0 else worth for h, worth in zip(SPACINGS, shear, strict=True))
    monkeypatch.setitem(DRIFT, "maxwellian", (along, across, thicker))
    found = dict(conduction.describe(job))
    assert found["heat conduction"].endswith("viscosity 1.050")
    assert 'scheme.drift = "seventh-order' in found["  warning"]


# --- the cooling state


def test_a_discrete_gaussian_cools_as_it_is():
    """The granular ES-BGK model: what the scaling does the drag undoes, no drift touches the nodes' Gaussian."""
    points, half_width = (8, 10), 7.0
    collision = {"operator": "granular-es-bgk", "knudsen": 1.0, "restitution": 0.8}
    velocity = {"points": list(points), "half_width": half_width}
    tables = {"space": {"cells": []}, "velocity": velocity, "initial": {"state": "uniform"}, "time": {"end": 5.0}}
    job = Job.from_dict({**WAVE, **tables, "scaling": {"kind": "kinetic"}, "collision": collision})
    kinetic = run(job).kinetic
    axes = [(np.arange(n) + 0.5) * 2 * half_width / n - half_width for n in points]
    square = sum(x**2 for x in np.meshgrid(*axes, indexing="ij"))
    found = cumulant(kinetic.velocity_grid.unpack(kinetic.state()[0][0, 0]).reshape(points), square, 2)
    foretold = cooling_state.gaussian_a2(points, (half_width,) * 2)
    print(f"a_2 = {found:.5f}, foretold {foretold:.5f}")
    assert found < -0.05 and found == pytest.approx(foretold, rel=1e-6)
    assert cooling_state.gaussian_a2((24, 24, 24), (7.0,) * 3) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("drift", ["maxwellian", "van-leer"])
def test_the_command_gives_the_table_of_cooling_states(drift):
    found = grid_accuracy.cooling_errors(2, 20, (7.0, 8.0), 0.8, drift)
    wanted = [cooling_state.a2_error(drift, (20, 20), width, 0.8) for width in (7.0, 8.0)]
    np.testing.assert_allclose(found, wanted, atol=5e-4)


def test_of_cooling_states_off_the_table_nothing_is_promised():
    error = cooling_state.a2_error
    assert np.isnan(error("maxwellian", (10, 10), 7.0, 0.8)) and np.isnan(error("maxwellian", (24, 24), 4.0, 0.8))
    assert error("maxwellian", (30, 28), 7.0, 0.8) == error("maxwellian", (28, 28), 7.0, 0.8)
    assert error("maxwellian", (64, 64), 20.0, 0.8) == error("maxwellian", (32, 32), 10.0, 0.8)
    assert error("maxwellian", (24, 24), 7.0, 0.3) == error("maxwellian", (24, 24), 7.0, 0.5)
    assert abs(error("maxwellian", (24, 24), 7.0, 0.85)) < 0.003  # between 0.8 and 0.9


def test_check_says_what_the_cooling_state_is_worth():
    def text(**tables):
        cooling = {"operator": "boltzmann", "knudsen": 1.0, "restitution": 0.8}
        base = {"space": {"cells": []}, "velocity": {"points": [24, 24]}, "scaling": {"kind": "kinetic"}}
        job = Job.from_dict({**WAVE, **base, "initial": {"state": "uniform"}, "collision": cooling, **tables})
        return dict(cooling_state.describe(job)).get("cooling state", "")

    assert re.fullmatch(r"fourth cumulant -0\.02[2-8]\d on this velocity grid, exactly -0\.0252", text())
    assert re.match(r"fourth cumulant -0\.04\d\d on this", text(scheme={"drift": "van-leer"}))
    assert " if its moments were held, exactly" in text(scheme={"conservative": False})
    assert "off by more than was ever measured, exactly -0.0252" in text(velocity={"points": [10, 10]})
    assert text(scheme={"drift": "seventh-order"}) == ""
    assert text(scaling={"kind": "none"}) == ""
    assert text(velocity={"points": [24]}) == ""
    granular = {"operator": "granular-es-bgk", "knudsen": 1.0, "restitution": 0.8}
    assert text(collision=granular, velocity={"points": [12, 12, 8]}) == (
        "fourth cumulant -0.0405 on this velocity grid, exactly 0 in this model"
    )


def test_check_says_what_the_drift_conducts_and_the_cure(tmp_path, capsys):
    tables = {"scaling": {"kind": "kinetic"}, "collision": {"operator": "es-bgk", "knudsen": 0.05}}
    job = write(tmp_path / "bgk.toml", **tables, velocity={"points": [24, 24, 24]}, scheme={"drift": "van-leer"})
    assert main(["check", job]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"heat conduction +0\.88\d of the exact one by the drift van-leer", printed)
    cures = re.search(r'take scheme.drift = "([a-z-]+)" \(1.00\d\) or velocity.points = (\[.*?\])', printed)
    better, points = cures.groups()
    for cure in (f'scheme.drift="{better}"', f"velocity.points={points}"):
        assert main(["check", job, "--set", cure]) == 0
        assert "  warning" not in capsys.readouterr().out
    assert main(["check", job, "--set", "velocity.points=[24, 24, 8]"]) == 0
    assert "cancel each other" in capsys.readouterr().out
    assert main(["check", job, "--set", 'scaling.kind="none"']) == 0
    assert re.search(r"heat conduction +1\.000 of the exact one by discrete Gaussians", capsys.readouterr().out)
