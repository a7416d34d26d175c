"""The plotting scripts: what they compute, what they draw, and how they refuse."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from mpi4py import MPI

from rvm_mpi import results
from rvm_mpi.job.job import Job
from rvm_mpi.output.fields import FieldsFile
from rvm_mpi.output.history import History
from rvm_mpi.output.layout import field_layout

POSTPROCESS = Path(__file__).resolve().parents[2] / "postprocess"
sys.path.insert(0, str(POSTPROCESS))

import common  # noqa: E402
import contours  # noqa: E402
import history  # noqa: E402
import marginals  # noqa: E402
import profiles  # noqa: E402
import waves  # noqa: E402

DPI = 40  # coarse pictures are drawn faster
common.plt.rcParams["savefig.dpi"] = DPI

TIMES = [0.0, 0.5, 1.0, 2.0]


def density(model, time, x, y):
    return 1 + 0.5 * np.exp(-time) * np.cos(2 * np.pi * x) * np.cos(4 * np.pi * y) * (
        1 if model == "kinetic" else 0.8
    )


def temperature(model, time, x, y):
    return (1 if model == "kinetic" else 1.1) * (2 + np.sin(2 * np.pi * y)) / (1 + time) ** 2 + 0 * x


def make_run(directory, cells=(12, 8), times=TIMES, marginals=True, fluid=True, snapshots=None):
    """A run directory with fields given by the functions above and a plain history."""
    directory.mkdir()
    space = {"cells": list(cells), "lower": [-1.0, 0.0][: len(cells)], "upper": [1.0, 1.0][: len(cells)]}
    job = Job.from_dict(
        {
            "title": "a $run$ of costs",
            "space": space,
            "velocity": {"points": [16, 6, 4], "half_width": 7.0},
            "collision": {"operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.9},
            "initial": {"state": "uniform"},
            "fluid": {"enabled": fluid},
            "time": {"end": times[-1]},
            "output": {"times": times, "marginals": marginals},
        }
    )
    (directory / "job.toml").write_text(job.to_toml())
    nx, ny = (*cells, 1, 1)[:2]
    domain = SimpleNamespace(dimensions=len(cells), start=(0, 0), local=(nx, ny))
    x, y = np.meshgrid(-1 + (np.arange(nx) + 0.5) * 2 / nx, (np.arange(ny) + 0.5) / ny)
    xi = -7 + (np.arange(16) + 0.5) * 14 / 16
    rows = History(directory / "history.csv", (*HISTORY, "correction"))
    with FieldsFile(directory / "fields.h5", MPI.COMM_SELF, domain, job, {}) as file:
        for index, time in enumerate(times[:snapshots]):
            fields = {
                name: np.zeros((ny, nx, *v.shape[len(cells) :]))
                for name, v in field_layout(job).items()
            }
            for model in ("kinetic", "fluid")[: 1 + fluid]:
                fields[f"{model}/density"][...] = density(model, time, x, y)
                fields[f"{model}/temperature"][...] = temperature(model, time, x, y)
                fields[f"{model}/velocity"][..., 0] = time * np.sin(np.pi * x)
                fields[f"{model}/velocity"][..., 1] = -time * np.sin(np.pi * y)
            omega = np.sqrt(temperature("kinetic", time, x, y))
            fields["scaling/omega"][...] = omega
            if marginals:
                g1 = np.exp(-(xi**2) / 2) / np.sqrt(2 * np.pi)
                fields["marginal/x"][...] = fields["kinetic/density"][..., None] * g1
            file.write(index, time, fields)
    for step, time in enumerate(np.linspace(0, times[-1], 30)):
        values = dict.fromkeys((*HISTORY, "correction"), 0.0)
        values.update(step=step, time=time, mass=2.0 + 1e-15 * step, energy=6 / (1 + time) ** 2, max_g=0.1)
        values.update(mean_temperature=2 / (1 + time) ** 2, min_g=-1e-14, fluid_energy=6 / (1 + time) ** 2)
        values["correction"] = 1e-4 * (step > 0)
        rows.append(values)
    rows.close()
    return directory


HISTORY = (
    "step",
    "time",
    "mass",
    "energy",
    "fluid_energy",
    "mean_temperature",
    "min_g",
    "max_g",
)


def figures(directory):
    return sorted(path.name for path in (directory / "figures").iterdir())


def both(*names):
    return sorted(f"{name}.{suffix}" for name in names for suffix in ("pdf", "png"))


CONTOURS = [
    "contours_density",
    "contours_velocity_x",
    "contours_velocity_y",
    "contours_temperature",
    "contours_last",
]


@pytest.mark.parametrize(
    ("script", "cells", "names"),
    [
        (contours, (12, 8), CONTOURS),
        (history, (12, 8), ["history_cooling", "history_density", "history_health"]),
        (history, (), ["history_cooling", "history_health"]),
        (profiles, (12, 8), ["profiles"]),
        (profiles, (12,), ["profiles"]),
        (marginals, (), ["marginals"]),
        (marginals, (12,), ["marginals"]),
        (marginals, (12, 8), ["marginals"]),
    ],
)
def test_each_script_writes_png_and_pdf_and_prints_the_paths(tmp_path, capsys, script, cells, names):
    directory = make_run(tmp_path / "run", cells)
    assert script.main([str(directory)]) == 0
    assert figures(directory) == both(*names)
    printed = [line for line in capsys.readouterr().out.splitlines() if not line.startswith("#")]
    assert sorted(Path(line).name for line in printed) == both(*names)
    for path in (directory / "figures").iterdir():
        assert path.stat().st_size > 2000


def test_a_script_runs_by_itself_without_mpi_and_from_anywhere(tmp_path):
    directory = make_run(tmp_path / "run")
    clean = {
        k: v for k, v in os.environ.items() if not k.startswith(("OMPI", "PMI", "MPI", "H5PY", "PYTHONPATH"))
    }
    code = (
        "import sys, runpy\n"
        f"sys.argv = ['marginals.py', {str(directory)!r}]; sys.path.insert(0, {str(POSTPROCESS)!r})\n"
        f"try: runpy.run_path({str(POSTPROCESS / 'marginals.py')!r}, run_name='__main__')\n"
        "except SystemExit as end:\n"
        "    print('EXIT', end.code, 'mpi4py.MPI' in sys.modules, 'petsc4py' in sys.modules)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=clean, cwd=tmp_path, timeout=120
    )
    assert run.stdout.splitlines()[-1] == "EXIT 0 False False", run.stdout + run.stderr


def test_a_run_without_fluid_has_one_row(tmp_path):
    directory = make_run(tmp_path / "run", fluid=False)
    assert history.main([str(directory)]) == 0
    assert profiles.main([str(directory), "--times", "1"]) == 0
    run = common.open_run(directory)
    figure = contours._by_time(run, "density", "density", [0, 1], "shared", common.models(run))
    assert len(figure.axes) == 2 + 1


@pytest.fixture
def drawn(monkeypatch):
    """Records each map of cells: axis, centres, values, limits, colours."""
    from matplotlib.axes import Axes

    calls = []
    original = Axes.pcolormesh

    def record(axis, x, y, values, **more):
        if "vmin" in more:  # a colour bar draws itself with this, too
            limits = more["vmin"], more["vmax"]
            calls.append(SimpleNamespace(axis=axis, x=x, y=y, values=values, limits=limits, **more))
        return original(axis, x, y, values, **more)

    monkeypatch.setattr(Axes, "pcolormesh", record)
    return calls


BOTH = ["kinetic", "fluid"]


def extent(values):
    return float(values.min()), float(values.max())


@pytest.mark.parametrize("own", [True, False])
def test_all_times_share_the_colour_limits_of_their_row_or_of_both(tmp_path, drawn, own):
    run = common.open_run(make_run(tmp_path / "run"))
    figure = contours._by_time(run, "temperature", "T", [0, 1, 3], "shared", BOTH, own)
    assert len(figure.axes) == 2 * 3 + 1 + own
    assert len(drawn) == 6
    kinetic, fluid = (common.field(run, model, "temperature")[[0, 1, 3]] for model in BOTH)
    both = np.concatenate([kinetic, fluid])
    expected = [extent(kinetic), extent(fluid)] if own else [extent(both)] * 2
    # kinetic above fluid, times from left to right
    for number, (call, values) in enumerate(
        zip(sorted(drawn, key=lambda c: figure.axes.index(c.axis)), both, strict=True)
    ):
        assert call.limits == expected[number // 3]
        assert np.array_equal(call.values, values)
        assert call.shading == "nearest"  # a colour for each cell
        assert call.axis.get_aspect() in (1.0, "equal")
    assert [axis.get_title() for axis in figure.axes[:3]] == ["$t = 0$", "$t = 0.5$", "$t = 2$"]
    assert [axis.get_ylabel().split("\n")[0] for axis in figure.axes[:6:3]] == BOTH


@pytest.mark.parametrize("own", [True, False])
def test_per_time_limits(tmp_path, drawn, own):
    run = common.open_run(make_run(tmp_path / "run"))
    figure = contours._by_time(run, "temperature", "T", [0, 3], "per-time", BOTH, own)
    assert len(figure.axes) == 2 * 2 + (4 if own else 2)
    kinetic, fluid = (common.field(run, model, "temperature")[[0, 3]] for model in BOTH)
    together = {extent(np.stack([kinetic[k], fluid[k]])) for k in range(2)}
    assert {call.limits for call in drawn} == ({extent(v) for v in (*kinetic, *fluid)} if own else together)


def test_what_fades_over_time_has_limits_of_its_own_at_each(tmp_path, drawn):
    run = common.open_run(make_run(tmp_path / "run"))
    assert len(contours._by_time(run, "density", "rho", [0, 3], "auto", BOTH).axes) == 4 + 2
    for _ in range(2):
        run.kinetic_density.values[3] = 1.0 + 0.05 * (run.kinetic_density.values[3] - 1.0)
        assert len(contours._by_time(run, "density", "rho", [0, 3], "auto", BOTH).axes) == 4 + 4
    run.kinetic_density.values[3] = 1.0 + 1e-15 * run.kinetic_density.values[3]  # uniform: nothing to be seen
    assert len(contours._by_time(run, "density", "rho", [0, 3], "auto", BOTH).axes) == 4 + 2


@pytest.mark.parametrize(
    ("arguments", "rows"), [([], BOTH), (["--no-fluid"], BOTH[:1]), (["--no-kinetic"], BOTH[1:])]
)
def test_either_row_can_be_left_out(tmp_path, monkeypatch, arguments, rows):
    directory = make_run(tmp_path / "run")
    seen = []
    monkeypatch.setattr(common, "save", lambda figure, *_: seen.append([a.get_ylabel() for a in figure.axes]))
    assert contours.main([str(directory), "--times", "0", "1", *arguments]) == 0
    assert len(seen) == 5
    for labels in seen:
        assert [name for name in BOTH if any(label.startswith(f"{name}\n") for label in labels)] == (
            rows if rows != ["kinetic"] else []  # alone it needs no name
        )


def test_what_is_left_out_must_leave_something(tmp_path, capsys):
    directory = make_run(tmp_path / "run", fluid=False)
    assert contours.main([str(directory), "--no-kinetic"]) == 2
    assert "holds no fluid" in capsys.readouterr().err


def test_cells_fill_the_domain(tmp_path, drawn):
    run = common.open_run(make_run(tmp_path / "run"))
    figure = contours._by_time(run, "density", "rho", [0], "shared", BOTH)
    call = drawn[0]
    assert call.axis.get_xlim() == pytest.approx((-1, 1))
    assert call.axis.get_ylim() == pytest.approx((0, 1))
    corners = figure.axes[0].collections[0].get_coordinates().reshape(-1, 2)
    assert (*corners.min(axis=0), *corners.max(axis=0)) == pytest.approx((-1, 0, 1, 1))


def test_velocity_limits_are_symmetric():
    assert contours._limits("velocity_x", np.array([-1.0, 3.0, 2.0]), 1.0) == (-3.0, 3.0)
    assert contours._limits("velocity_y", np.zeros(4), 0.0) == (-1.0, 1.0)


@pytest.mark.parametrize("size", [1.0, 2.0**-66, 2.0**66])
def test_what_is_nought_but_for_rounding_is_so_in_any_units(size):
    """A velocity against the thermal speed, anything else against its own size."""
    assert contours._limits("velocity_x", size * np.array([-1e-16, 3e-15]), 2 * size) == (-2 * size, 2 * size)
    assert contours._limits("velocity_x", size * np.array([-1e-3, 3e-3]), size) == (-3e-3 * size, 3e-3 * size)
    low, high = contours._limits("density", size * np.array([1.0, 1.0 + 1e-15]), size)
    assert high - low == pytest.approx(0.1 * size)
    assert contours._limits("density", size * np.array([1.0, 1.0 + 1e-6]), size) == (size, size * (1 + 1e-6))


def test_constant_and_broken_fields():
    low, high = contours._limits("density", np.full(5, 2.0), 2.0)
    assert low < 2.0 < high
    with pytest.raises(common.PlotError, match="not finite"):
        contours._limits("density", np.array([1.0, np.nan]), np.nan)


@pytest.mark.parametrize("scale", ["shared", "per-time"])
def test_no_text_is_cut_off_or_overlaps_the_next_panel(tmp_path, scale):
    run = common.open_run(make_run(tmp_path / "run"))
    figure = contours._by_time(run, "density", "density", [0, 1, 2, 3], scale, BOTH)
    figure.canvas.draw()
    boxes = [axis.get_tightbbox(figure.canvas.get_renderer()) for axis in figure.axes]
    for number, box in enumerate(boxes):
        assert box.x0 > -1 and box.y0 > -1 and box.x1 < figure.bbox.x1 + 1 and box.y1 < figure.bbox.y1 + 1
        for other in boxes[number + 1 :]:
            overlap = (
                min(box.x1, other.x1) - max(box.x0, other.x0),
                min(box.y1, other.y1) - max(box.y0, other.y0),
            )
            assert min(overlap) < 8


@pytest.mark.parametrize(
    ("script", "cells", "arguments", "message"),
    [
        (contours, (12,), [], "has 1 space dimensions: use profiles.py"),
        (contours, (), [], "use history.py or marginals.py"),
        (profiles, (), [], "no space dimension"),
        (contours, (12, 8), ["--times", "0.7"], "no snapshot at t = 0.7; stored are 0, 0.5, 1, 2"),
    ],
)
def test_what_cannot_be_drawn_is_one_line_and_exit_2(tmp_path, capsys, script, cells, arguments, message):
    directory = make_run(tmp_path / "run", cells)
    assert script.main([str(directory), *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not (directory / "figures").exists()


@pytest.mark.parametrize("script", [contours, history, profiles, marginals])
def test_a_directory_that_is_no_run_or_has_no_snapshot(tmp_path, capsys, script):
    assert script.main([str(tmp_path)]) == 2
    assert "fields.h5: no such file" in capsys.readouterr().err
    assert script.main([str(make_run(tmp_path / "run", snapshots=0))]) == 2
    assert "has no snapshot yet" in capsys.readouterr().err


def test_marginals_that_were_not_stored(tmp_path, capsys):
    assert marginals.main([str(make_run(tmp_path / "run", marginals=False))]) == 2
    assert "output.marginals = true" in capsys.readouterr().err


def test_an_unfinished_run_is_drawn_as_far_as_it_is(tmp_path):
    directory = make_run(tmp_path / "run", snapshots=2)
    assert common.open_run(directory).time.values.tolist() == [0.0, 0.5]
    assert profiles.main([str(directory)]) == 0


def test_several_runs_in_one_figure(tmp_path):
    first, second = make_run(tmp_path / "a", (12,)), make_run(tmp_path / "b", (20,))
    assert profiles.main([str(first), str(second), "--normalised", "--times", "0.5", "2"]) == 0
    assert figures(first) == both("profiles")
    assert not (second / "figures").exists()


def test_of_equal_profiles_both_are_seen(tmp_path, monkeypatch):
    """Every run's colours are in the picture, and the earlier the run the more of them sticks out."""
    directories = [str(make_run(tmp_path / name, (12,))) for name in "abc"]
    figures_made = []
    monkeypatch.setattr(common, "save", lambda figure, *_: figures_made.append(figure))
    assert profiles.main([*directories, "--times", "1", "--no-fluid"]) == 0
    (figure,) = figures_made
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3].reshape(-1, 3)
    box = figure.axes[0].get_window_extent()
    shape = figure.canvas.get_width_height()[::-1]
    panel = pixels.reshape(*shape, 3)[int(shape[0] - box.y1) : int(shape[0] - box.y0), int(box.x0) : int(box.x1)]
    for number in range(3):
        wanted = np.round(255 * np.array(to_rgb(f"C{number}")))
        assert (np.abs(panel - wanted).max(-1) < 40).sum() > 20


def test_profiles_with_and_without_the_fluid(tmp_path, monkeypatch):
    directories = [str(make_run(tmp_path / name, (12,))) for name in "ab"]
    drawn = []
    monkeypatch.setattr(
        common, "save", lambda figure, *_: drawn.append({line.get_label() for line in figure.axes[0].get_lines()})
    )
    for arguments in (directories[:1], [*directories[:1], "--no-fluid"], directories, [*directories, "--no-fluid"]):
        assert profiles.main(arguments) == 0
    assert drawn == [
        {"kinetic", "fluid"},
        {"kinetic"},
        {"a, kinetic", "a, fluid", "b, kinetic", "b, fluid"},
        {"a", "b"},
    ]


def test_chosen_times():
    run = SimpleNamespace(time=SimpleNamespace(values=np.linspace(0, 1, 101)))
    assert common.choose_times(run, None) == [0, 20, 40, 60, 80, 100]
    assert common.choose_times(run, [0.25, 0.0]) == [25, 0]
    run = SimpleNamespace(time=SimpleNamespace(values=np.array([0.0, 0.25, 30.0])))
    assert common.choose_times(run, None) == [0, 1, 2]


def test_haffs_law_solves_its_equation():
    time = np.linspace(0, 5, 2001)
    law = history.haff(time, 2.0, 0.7, 0.3)
    assert law[0] == 2.0
    slope = np.gradient(law, time, edge_order=2)
    assert slope[1:-1] == pytest.approx((-2 * 0.3 * 0.7 * law**1.5)[1:-1], rel=1e-4)


def test_damping_rate_of_plain_and_oscillating_decay():
    time = np.geomspace(0.5, 50, 400)
    rate, fitted_time, fit = history.damping_rate(time, 3 * time**-1.7)
    assert rate == pytest.approx(-1.7)
    assert fit == pytest.approx(3 * fitted_time**-1.7)
    oscillating = np.abs(time**-1.4 * np.cos(9 * np.log(time))) + 1e-9
    rate, peaks, _ = history.damping_rate(time, oscillating)
    assert rate == pytest.approx(-1.4, abs=0.05)
    assert 8 <= len(peaks) <= 14


@pytest.mark.parametrize(
    "values",
    [
        np.ones(20),
        np.linspace(1, 2, 20),
        np.concatenate([np.ones(19), [0.1]]),
        np.random.default_rng(0).uniform(0.1, 1, 20),
    ],
)
def test_no_damping_rate_where_there_is_no_damping(values):
    assert history.damping_rate(np.linspace(1, 10, 20), values) is None
    assert history.damping_rate(np.arange(1.0, 6.0), np.arange(1.0, 6.0) ** -2) is None


def test_means_over_the_domain(tmp_path):
    run = common.open_run(make_run(tmp_path / "run"))
    for index in (0, 3):
        rho, temperature_ = run.kinetic_density.values[index], run.kinetic_temperature.values[index]
        expected = (rho * temperature_).sum() / rho.sum()
        assert history.mean_temperature(run, "kinetic")[index] == pytest.approx(expected)
        assert history.variance(run, "fluid")[index] == pytest.approx(run.fluid_density.values[index].var())
        assert history.deviation(run, "kinetic")[index] == pytest.approx(np.abs(rho - 1).mean())


def test_errors_of_what_is_conserved():
    columns = {"mass": np.array([2.0, 2.1]), "energy_error": np.array([0.0, 0.3])}
    found = history.errors({**columns, "momentum_error": np.full(2, np.nan)})
    assert list(found) == ["mass", "energy"]
    assert found["mass"] == pytest.approx([0, 0.05])


def test_mass_error_leaves_out_what_entered():
    columns = {
        "mass": np.array([2.0, 3.0, 5.0 + 2e-6]),
        "entered_mass_x-lower": np.array([0.0, 1.5, 4.0]),
        "entered_mass_x-upper": np.array([0.0, -0.5, -1.0]),
    }
    assert history.mass_error(columns) == pytest.approx([0, 0, 1e-6], abs=1e-12)
    assert history.mass_error({"mass": np.array([2.0, 2.1])}) == pytest.approx([0, 0.05])


@pytest.mark.parametrize(("n", "expected"), [(5, 2.0), (6, 2.5)])
def test_cut_through_the_middle(n, expected):
    values = np.broadcast_to(np.arange(float(n))[:, None], (3, n, 4))
    assert profiles.middle_cut(values, "x") == pytest.approx(np.full((3, 4), expected))
    assert profiles.middle_cut(values.swapaxes(1, 2), "y") == pytest.approx(np.full((3, 4), expected))


def test_normalised_profiles_have_mean_one(tmp_path):
    run = common.open_run(make_run(tmp_path / "run", (12,)))
    values = profiles.profile(run, "kinetic", "temperature", normalised=True)
    assert values.mean(axis=1) == pytest.approx(np.ones(4))
    velocity = profiles.profile(run, "kinetic", "velocity_x", normalised=True)
    assert np.array_equal(velocity, run.kinetic_velocity.values[:, :, 0])


def test_the_classical_marginal_is_the_scaled_one_stretched():
    xi = -7 + (np.arange(400) + 0.5) * 14 / 400
    omega = np.array([0.5, 4.0])
    g1 = np.exp(-(xi**2) / 2) / np.sqrt(2 * np.pi)
    v = np.linspace(-30, 30, 6001)
    f1 = marginals.classical(np.stack([g1, g1]), xi, omega, v)
    for row, w in zip(f1, omega, strict=True):
        assert row == pytest.approx(np.exp(-((v / w) ** 2) / 2) / np.sqrt(2 * np.pi) / w, abs=2e-4)
        assert row.sum() * 0.01 == pytest.approx(1, abs=1e-4)


def test_titles_are_not_read_as_mathematics(tmp_path):
    assert common.title_of(common.open_run(make_run(tmp_path / "run"))) == r"a \$run\$ of costs"


@pytest.mark.parametrize(
    ("titles", "common_part"),
    [
        (["Test 1: coupled model", "Test 1: classical variables"], "Test 1"),
        (["Test 2: walls: one", "Test 2: walls: one"], "Test 2: walls: one"),
        (["Test 2: walls: one", "Test 2: walls: other"], "Test 2: walls"),
        (["cold", "coal"], ""),
    ],
)
def test_several_runs_have_the_title_they_share(titles, common_part):
    assert common.title_of(*(SimpleNamespace(attrs={"title": title}) for title in titles)) == common_part


def decaying(time, rate=-1.4, frequency=4.0, floor=0.0):
    """A damped oscillation in log t, as L(t) has it."""
    return 0.05 * time**rate * np.abs(np.cos(frequency * np.log(time))) + floor


def test_damping_of_oscillations_in_log_t_and_where_it_ends():
    time = np.geomspace(0.3, 30, 3000)
    rate, period, place, fit = waves.damping(time, decaying(time), floor=1e-6)
    assert rate == pytest.approx(-1.4, rel=1e-3)
    assert period == pytest.approx(2 * np.pi / 4.0, rel=1e-3)
    assert fit == pytest.approx(decaying(place), rel=1e-2)
    above = waves.damping(time, decaying(time), floor=3e-3)
    assert 2 <= len(above[2]) < len(place)
    assert waves.damping(time, decaying(time), floor=1.0) is None
    swelling = waves.damping(time, decaying(time) + 0.01 * (time > 5) * decaying(time, rate=1.0), floor=1e-6)
    assert swelling[2].max() < 6


@pytest.fixture
def wave_run(tmp_path):
    directory = make_run(tmp_path / "run", (12,))
    history = results.read_history(directory)
    time = np.concatenate([[0.0], np.geomspace(0.01, 30, 2000)])
    with (directory / "history.csv").open("w") as file:
        file.write(",".join([*history, "density_deviation"]) + "\n")
        for step, t in enumerate(time):
            row = dict.fromkeys([*history, "density_deviation"], 0.0)
            row.update(step=step, time=t, mass=2.0, energy=1 / (1 + t) ** 2, mean_temperature=1 / (1 + t) ** 2)
            row["density_deviation"] = decaying(max(t, 0.01), -2.05)
            file.write(",".join(map(str, row.values())) + "\n")
    return directory


def test_the_table_has_the_fitted_rate_beside_the_papers(wave_run, capsys):
    assert waves.main([str(wave_run), "--labels", "mine", "--floor", "1e-6"]) == 0
    assert figures(wave_run) == both("waves_deviation", "waves_energy")
    title, row = [line for line in capsys.readouterr().out.splitlines() if line.startswith("#")]
    assert title.split()[1:] == ["run", "e", "maxima", "rate", "paper", "period", "in", "log", "t"]
    name, e, _, rate, paper, period = row.split()[1:]
    assert (name, float(e), float(paper)) == ("mine", 0.9, -2.05)
    assert float(rate) == pytest.approx(-2.05, rel=2e-3)
    assert float(period) == pytest.approx(np.pi / 2, rel=2e-3)


def rewritten(directory, **columns):
    """The run with columns of its history put in place of others, or added."""
    history = {**results.read_history(directory), **columns}
    rows = zip(*history.values(), strict=True)
    lines = [",".join(history), *(",".join(str(value) for value in row) for row in rows)]
    (directory / "history.csv").write_text("\n".join(lines) + "\n")
    return directory


def test_waves_of_what_they_cannot_be_drawn_of(tmp_path, wave_run, capsys):
    n = 30
    uniform = make_run(tmp_path / "uniform", (12,))
    refused = {
        "no density_deviation": make_run(tmp_path / "other"),
        "no space dimension": rewritten(make_run(tmp_path / "0d", ()), density_deviation=np.zeros(n)),
        "the density stays uniform": rewritten(uniform, density_deviation=np.full(n, 1e-16)),
        "is not a number": rewritten(make_run(tmp_path / "broken", (12,)), density_deviation=np.full(n, np.nan)),
    }
    for message, directory in refused.items():
        assert waves.main([str(wave_run), str(directory)]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
        assert not (wave_run / "figures").exists()
    assert waves.main([str(wave_run), "--labels", "a", "b"]) == 2
    assert "2 labels for 1 runs" in capsys.readouterr().err


@pytest.mark.parametrize("script", [contours, history, profiles, marginals, waves])
def test_wrong_arguments_are_one_line_too(tmp_path, capsys, script):
    for arguments in ([], ["--no-such"], [str(tmp_path), "--colour"]):
        with pytest.raises(SystemExit) as end:
            script.main(arguments)
        assert end.value.code == 2
        assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("damage", ["job.toml", "history.csv", "fields.h5"])
@pytest.mark.parametrize("script", [contours, history, profiles, marginals, waves])
def test_a_damaged_run_is_refused_in_one_line_or_drawn(tmp_path, capsys, monkeypatch, script, damage):
    monkeypatch.setattr(common, "save", lambda *_: None)  # files take seconds
    directory = make_run(tmp_path / "run", (12, 8))
    (directory / damage).write_bytes(b"not = what, it was\n\xff")
    status = script.main([str(directory)])
    assert status in (0, 2)
    assert capsys.readouterr().err.count("\n") == (1 if status else 0)


# --- what the pictures claim


@pytest.fixture
def shown(tmp_path, monkeypatch):
    """Draws a script's figures of a run into nothing; returns them by name."""

    def draw(script, directory, *arguments):
        figures = {}
        monkeypatch.setattr(common, "save", lambda figure, _, name: figures.update({name: figure}))
        assert script.main([str(directory), *arguments]) == 0
        return figures

    return draw


def test_titles_say_what_is_shown(tmp_path, wave_run, shown):
    plane, homogeneous = make_run(tmp_path / "plane"), make_run(tmp_path / "0d", ())
    for script, directory, words in (
        (history, plane, ["temperature and energy", "density", "errors"]),
        (contours, plane, ["density", "velocity", "velocity", "temperature", "t = 2"]),
        (profiles, plane, ["profiles along $x$ at $y = 0.5$"]),
        (marginals, plane, ["first marginals along $x$ at $y = 0.5$"]),
        (marginals, homogeneous, ["first marginals of g and of f"]),
        (waves, wave_run, ["energy", "deviation of the density"]),
    ):
        for figure, what in zip(shown(script, directory).values(), words, strict=True):
            title = figure._suptitle.get_text() if figure._suptitle else figure.axes[0].get_title()
            assert title.startswith(r"a \$run\$ of costs – ")
            assert what in title


def test_legends_lie_outside_the_panels(tmp_path, wave_run, shown):
    """Where no curve can run through them."""
    plane, homogeneous = make_run(tmp_path / "plane"), make_run(tmp_path / "0d", ())
    legends = 0
    for script, directory in ((history, plane), (marginals, homogeneous), (profiles, plane), (waves, wave_run)):
        for figure in shown(script, directory).values():
            figure.canvas.draw()
            renderer = figure.canvas.get_renderer()
            of_axes = [axis.get_legend() for axis in figure.axes if axis.get_legend()]
            for legend in (*of_axes, *figure.legends):
                legends += 1
                box = legend.get_window_extent(renderer)
                assert not any(box.overlaps(axis.get_window_extent(renderer)) for axis in figure.axes)
    assert legends >= 10


def test_errors_of_rounding_and_the_smallest_g_have_a_log_axis(tmp_path, shown):
    n = 30
    sign = np.where(np.arange(n) % 2, 1.0, -1.0)
    error = np.where(np.arange(n) % 3, 2e-16, 0.0)
    directory = rewritten(make_run(tmp_path / "run"), energy_error=error, min_g=sign * np.geomspace(1e-30, 1e-5, n))
    errors, smallest, correction = shown(history, directory)["history_health"].axes
    assert {axis.get_yscale() for axis in (errors, smallest, correction)} == {"log"}
    energy = next(line for line in errors.get_lines() if line.get_label() == "energy").get_ydata()
    assert set(energy) == {2e-16, history.NOUGHT}  # nought is drawn, not left out
    above, below = (line.get_ydata() for line in smallest.get_lines())
    assert np.array_equal(np.isfinite(above), sign > 0)
    assert np.array_equal(np.isfinite(below), sign < 0)
    assert np.nanmax(below) < 1e-3
    assert np.nanmin(below) > 0


def test_cooling_is_drawn_over_haffs_law(tmp_path, shown):
    """The law itself spans decades in which no departure can be seen."""
    directory = make_run(tmp_path / "run")
    job = Job.from_file(directory / "job.toml")
    time = results.read_history(directory)["time"]
    run = common.open_run(directory)
    start, mean = history.mean_temperature(run, "kinetic")[0], run.kinetic_density.values[0].mean()
    law = history.haff(time, start, mean, job.collision.cooling)
    rewritten(directory, mean_temperature=1.02 * law, energy=6 * 1.06 * law / law[0])
    (_, right) = shown(history, directory)["history_cooling"].axes
    lines = {line.get_label(): line.get_ydata() for line in right.get_lines()}
    assert lines["kinetic, temperature"] == pytest.approx(np.full(29, 1.02))
    assert lines["kinetic, energy"] == pytest.approx(np.full(29, 1.0))  # over that of its start
    assert right.get_yscale() == "linear"
