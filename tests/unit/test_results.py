"""fields.h5, fields.xdmf and history.csv, written and read by one process."""

import csv
import math
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI

from rvm_mpi import results
from rvm_mpi.output import hdf5
from rvm_mpi.output.fields import FieldsFile
from rvm_mpi.output.history import History
from rvm_mpi.output.layout import Layout, field_layout
from rvm_mpi.output.xdmf import Xdmf

ALL_SIZES = [((), 1), ((), 2), ((9,), 1), ((9,), 3), ((7, 5), 2), ((7, 5), 3)]


def make_job(cells=(7, 5), d=3, times=(0.0, 0.5, 2.0), kind="kinetic", fluid=True, marginals=True):
    n = len(cells)
    lower, upper = (-1.0, 2.0)[:n], (1.0, 3.0)[:n]
    return SimpleNamespace(
        title="a test",
        text="[space]\n",
        space=SimpleNamespace(
            cells=cells,
            lower=lower,
            upper=upper,
            dimensions=n,
            spacing=tuple((b - a) / c for a, b, c in zip(lower, upper, cells, strict=True)),
        ),
        velocity=SimpleNamespace(points=(8, 6, 4)[:d], half_width=(7.0,) * d, dimensions=d),
        scaling=SimpleNamespace(kind=kind),
        fluid=SimpleNamespace(enabled=fluid),
        output=SimpleNamespace(times=times, marginals=marginals),
    )


def make_domain(job):
    nx, ny = (*job.space.cells, 1, 1)[:2]
    return SimpleNamespace(dimensions=job.space.dimensions, start=(0, 0), local=(nx, ny))


def make_file(directory, job, **more):
    attributes = {"version": "1.2.3", "ranks": 1}
    domain = make_domain(job)
    return FieldsFile(directory / "fields.h5", MPI.COMM_SELF, domain, job, attributes, **more)


def random_fields(job, seed=0):
    rng = np.random.default_rng(seed)
    nx, ny = (*job.space.cells, 1, 1)[:2]
    return {
        name: rng.normal(size=(ny, nx, *layout.shape[job.space.dimensions :]))
        for name, layout in field_layout(job).items()
    }


@pytest.mark.parametrize(("cells", "d"), ALL_SIZES)
def test_what_is_written_is_read_back(tmp_path, cells, d):
    job = make_job(cells, d)
    fields = [random_fields(job, seed) for seed in range(3)]
    with make_file(tmp_path, job) as file:
        for index, time in enumerate(job.output.times):
            file.write(index, time, fields[index])
    run = results.open_run(tmp_path)
    assert run.time.values.tolist() == [0.0, 0.5, 2.0]
    assert len(run.data_vars) == 11
    space = ("y", "x")[2 - len(cells) :]
    shape = tuple(reversed(cells))
    assert run.kinetic_density.dims == ("time", *space)
    assert run.kinetic_stress.shape == (3, *shape, d, d)
    assert run.marginal_x.dims == ("time", *space, "xi_x")
    assert run.component.values.tolist() == ["x", "y", "z"][:d]
    for name, layout in field_layout(job).items():
        values = run[name.replace("/", "_")].values
        for index in range(3):
            assert np.array_equal(values[index], fields[index][name].reshape(layout.shape)), name


def test_coordinates_and_attributes(tmp_path):
    job = make_job()
    with make_file(tmp_path, job, xi_x=np.arange(8.0)):
        pass
    run = results.open_run(tmp_path)
    assert run.x.values == pytest.approx(-1 + (np.arange(7) + 0.5) * 2 / 7)
    assert run.y.values == pytest.approx([2.1, 2.3, 2.5, 2.7, 2.9])
    assert run.xi_x.values.tolist() == list(range(8))
    assert run.attrs == {"version": "1.2.3", "ranks": 1, "title": "a test", "job": "[space]\n"}
    assert "temperature tensor" in run.kinetic_stress.attrs["long_name"]
    assert "1/2" in run.kinetic_heat_flux.attrs["long_name"]
    assert all(run[name].attrs["units"] for name in run.data_vars)
    assert run.fluid_density.attrs["path"] == "/fluid/density"


def test_velocity_nodes_are_cell_centres_unless_given(tmp_path):
    with make_file(tmp_path, make_job((), 3)):
        pass
    nodes = results.open_run(tmp_path).xi_x.values
    assert nodes == pytest.approx(np.linspace(-7 + 0.875, 7 - 0.875, 8))


@pytest.mark.parametrize(
    ("kind", "enabled", "stored"),
    [
        ("kinetic", True, True),
        ("kinetic", False, False),
        ("macroscopic", False, True),
        ("none", False, False),
    ],
)
def test_which_groups_are_there(tmp_path, kind, enabled, stored):
    job = make_job(kind=kind, fluid=enabled, marginals=False)
    with make_file(tmp_path, job):
        pass
    names = set(results.open_run(tmp_path).data_vars)
    assert {"kinetic_density", "scaling_omega"} < names
    assert ("fluid_temperature" in names) is stored
    assert "marginal_x" not in names


def test_structure_is_contiguous_complete_and_allocated_from_the_start(tmp_path):
    import h5py

    job = make_job()
    with make_file(tmp_path, job):
        size = (tmp_path / "fields.h5").stat().st_size
    with h5py.File(tmp_path / "fields.h5", "r") as file:
        assert np.isnan(file["time"][()]).all()
        for name, layout in field_layout(job).items():
            assert file[name].shape == (3, *layout.shape)
            assert file[name].chunks is None
            assert file[name].id.get_offset() is not None
            assert np.isnan(file[name][()]).all()
    with make_file(tmp_path, job, resume=True) as file:
        for index in range(3):
            file.write(index, float(index), random_fields(job))
    assert (tmp_path / "fields.h5").stat().st_size == size
    assert [path.name for path in tmp_path.iterdir()] == ["fields.h5"]


def test_only_times_that_exist_are_read_also_while_the_file_is_open(tmp_path):
    job = make_job()
    with make_file(tmp_path, job) as file:
        assert results.open_run(tmp_path).sizes["time"] == 0
        file.write(0, 0.0, random_fields(job))
        file.write(2, 2.0, random_fields(job, 2))
        run = results.open_run(tmp_path / "fields.h5")
        assert run.time.values.tolist() == [0.0, 2.0]
        assert np.array_equal(run.scaling_omega.values[1], random_fields(job, 2)["scaling/omega"])


def test_a_failed_snapshot_does_not_exist_and_the_next_one_does(tmp_path):
    job = make_job()
    with make_file(tmp_path, job) as file:
        file.write(0, 0.0, random_fields(job))
        wrong = random_fields(job)
        wrong["kinetic/velocity"] = wrong["kinetic/velocity"][:, :, :2]
        with pytest.raises(OSError, match=r"snapshot 1 at t = 0\.5.*kinetic/velocity has shape \(5, 7, 2\)"):
            file.write(1, 0.5, wrong)
        assert results.open_run(tmp_path).time.values.tolist() == [0.0]
        # a snapshot that is being replaced is gone until the new one is complete
        with pytest.raises(OSError, match="kinetic/velocity"):
            file.write(0, 0.0, wrong)
        assert results.open_run(tmp_path).sizes["time"] == 0
        file.write(0, 0.0, random_fields(job, 7))
    run = results.open_run(tmp_path)
    assert np.array_equal(run.kinetic_density.values[0], random_fields(job, 7)["kinetic/density"])


def test_a_block_turned_round_is_refused(tmp_path):
    job = make_job()
    fields = random_fields(job)
    fields["kinetic/density"] = fields["kinetic/density"].T
    with make_file(tmp_path, job) as file, pytest.raises(OSError, match=r"\(7, 5\)"):
        file.write(0, 0.0, fields)


@pytest.mark.parametrize("change", ["missing", "unknown"])
def test_missing_and_unknown_fields_are_named(tmp_path, change):
    job = make_job()
    fields = random_fields(job)
    if change == "missing":
        del fields["fluid/density"]
    else:
        fields["fluid/densty"] = fields["fluid/density"]
    with make_file(tmp_path, job) as file, pytest.raises(OSError, match="missing or unknown: fluid/dens"):
        file.write(0, 0.0, fields)


def test_snapshot_number_out_of_range(tmp_path):
    job = make_job()
    with make_file(tmp_path, job) as file, pytest.raises(OSError, match="room for 3"):
        file.write(3, 3.0, random_fields(job))


def test_extra_datasets(tmp_path):
    job = make_job()
    extra = {
        "wall/x-lower/pressure": Layout((5,), ("y",), "pressure on the wall", "reference pressure"),
        "wall/x-lower/shear_stress": Layout((5, 2), ("y", "direction"), "shear stress"),
        "wall/total": Layout((), (), "one number"),
    }
    with make_file(tmp_path, job, extra=extra) as file:
        shares = {
            "wall/x-lower/pressure": ((slice(1, 4),), np.array([1.0, 2.0, 3.0])),
            "wall/x-lower/shear_stress": ((slice(0, 5), slice(0, 2)), np.arange(10.0).reshape(5, 2)),
            "wall/total": ((), 42.0),
        }
        file.write(0, 0.0, random_fields(job), shares)
        with pytest.raises(OSError, match="wall/none is not one of the extra"):
            file.write(1, 0.5, random_fields(job), {"wall/none": ((), 1.0)})
    run = results.open_run(tmp_path)
    assert np.array_equal(run.wall_x_lower_pressure.values, [[np.nan, 1, 2, 3, np.nan]], equal_nan=True)
    assert run.wall_x_lower_pressure.dims == ("time", "y")
    assert run.wall_x_lower_pressure.attrs["path"] == "/wall/x-lower/pressure"
    assert run.wall_x_lower_shear_stress.values[0].tolist() == np.arange(10.0).reshape(5, 2).tolist()
    assert run.wall_total.values.tolist() == [42.0]


@pytest.mark.parametrize("cells", [(), (4,), (4, 5)], ids=str)
@pytest.mark.parametrize("d", [1, 2, 3])
def test_parts_leave_out_axes_that_are_whole(tmp_path, cells, d):
    """A wall gives the cells of its faces and leaves the components to the file."""
    job = make_job(cells, d)
    extra = {"wall/shear_stress": Layout((5, d), ("y", "component"), "shear stress")}
    values = np.arange(3.0 * d).reshape(3, d)
    with make_file(tmp_path, job, extra=extra) as file:
        for row, time in enumerate(job.output.times):
            file.write(row, time, random_fields(job), {"wall/shear_stress": ((slice(2, 5),), row + values)})
    found = results.open_run(tmp_path).wall_shear_stress.values
    assert np.isnan(found[:, :2]).all()
    for row in range(len(found)):
        assert np.array_equal(found[row, 2:], row + values)


def test_many_snapshots_wait_for_the_disk_once_a_second(tmp_path, monkeypatch):
    """Each is there for who reads the file beside the run, whether or not the disk has it yet."""
    job = make_job(times=[0.01 * k for k in range(60)])
    waited, now = [], 0.0
    monkeypatch.setattr("rvm_mpi.output.fields.monotonic", lambda: now)
    with make_file(tmp_path, job) as file:
        real = file._flush
        monkeypatch.setattr(file, "_flush", lambda what, to_disk: (waited.append(to_disk), real(what, to_disk)))
        for row, time in enumerate(job.output.times):
            now += 0.1
            fields = random_fields(job, row)
            file.write(row, time, fields)
            run = results.open_run(tmp_path)
            assert run.time.values.tolist() == list(job.output.times[: row + 1])
            assert np.array_equal(run.kinetic_density.values[-1].ravel(), fields["kinetic/density"].ravel())
        assert len(waited) == 120 and 10 <= sum(waited) <= 14
        waited.clear()
        file.write(7, job.output.times[7], random_fields(job))  # taken again: never old values under a time
        assert waited == [True] * 3


def test_reopening_keeps_what_is_there_and_refuses_another_job(tmp_path):
    job = make_job()
    with make_file(tmp_path, job) as file:
        file.write(0, 0.0, random_fields(job))
    with make_file(tmp_path, job, resume=True) as file:
        file.write(1, 0.5, random_fields(job, 1))
    run = results.open_run(tmp_path)
    assert run.time.values.tolist() == [0.0, 0.5]
    assert np.array_equal(run.kinetic_density.values[0], random_fields(job)["kinetic/density"])
    with pytest.raises(OSError, match=r"fields.h5 cannot be opened for this job"):
        make_file(tmp_path, make_job((8, 5)), resume=True)
    assert results.open_run(tmp_path).equals(run)
    with pytest.raises(OSError, match="No such file"):
        make_file(tmp_path / "nowhere", job, resume=True)


def test_a_missing_directory_and_a_missing_run_are_one_clear_line(tmp_path):
    with pytest.raises(OSError, match=r"nowhere/fields.h5 cannot be created: .*No such file") as caught:
        make_file(tmp_path / "nowhere", make_job())
    assert "\n" not in str(caught.value)
    with pytest.raises(FileNotFoundError, match=r"no such file; is .* a run directory"):
        results.open_run(tmp_path)


def test_reading_needs_no_mpi(tmp_path):
    with make_file(tmp_path, make_job()) as file:
        file.write(0, 0.0, random_fields(make_job()))
    code = (
        "import sys; from rvm_mpi.results import open_run; run = open_run(sys.argv[1]); "
        "print(run.kinetic_density.shape, 'mpi4py.MPI' in sys.modules)"
    )
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI", "PMI", "MPI", "H5PY"))}
    answer = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        capture_output=True,
        text=True,
        env=clean,
        check=True,
        timeout=60,
    )
    assert answer.stdout.strip() == "(1, 5, 7) False"


def test_serial_h5py_with_several_ranks_says_what_is_missing(monkeypatch):
    config = SimpleNamespace(mpi=False)
    fake = SimpleNamespace(get_config=lambda: config, __file__="/somewhere/h5py/__init__.py")
    monkeypatch.setattr(hdf5, "import_h5py", lambda: fake)
    with pytest.raises(
        RuntimeError, match=r"/somewhere/h5py is built without MPI.*2 ranks.*python3-h5py-mpi"
    ):
        hdf5.parallel_h5py(SimpleNamespace(size=2))
    assert hdf5.parallel_h5py(SimpleNamespace(size=1)) is fake


def xdmf_values(item, directory):
    """Evaluate one HyperSlab item the way an XDMF reader does."""
    import h5py

    choice, data = item.findall("DataItem")
    start, stride, count = np.array(choice.text.split(), dtype=int).reshape(3, -1)
    name, path = data.text.split(":")
    with h5py.File(directory / name, "r") as file:
        dataset = file[path]
        assert list(dataset.shape) == [int(n) for n in data.get("Dimensions").split()]
        part = dataset[tuple(slice(a, a + n, s) for a, s, n in zip(start, stride, count, strict=True))]
    return part.reshape([int(n) for n in item.get("Dimensions").split()])


@pytest.mark.parametrize(("cells", "d"), ALL_SIZES)
def test_xdmf_leads_to_the_right_numbers(tmp_path, cells, d):
    job = make_job(cells, d)
    nx, ny = (*cells, 1, 1)[:2]
    with make_file(tmp_path, job) as file:
        file.write(0, 0.0, random_fields(job, 0))
        file.write(2, 2.0, random_fields(job, 2))
    description = Xdmf(tmp_path / "fields.xdmf", job, [math.nan] * 3)
    description.add(0, 0.0)
    description.add(2, 2.0)
    series = ET.parse(tmp_path / "fields.xdmf").getroot().find("Domain/Grid")
    grids = series.findall("Grid")
    assert [float(grid.find("Time").get("Value")) for grid in grids] == [0.0, 2.0]
    fields = random_fields(job, 2)
    found = {}
    for attribute in grids[1].findall("Attribute"):
        assert attribute.get("Center") == "Cell"
        kind = attribute.get("AttributeType")
        values = xdmf_values(attribute.find("DataItem"), tmp_path)
        assert values.shape == (ny, nx, *{"Scalar": (), "Vector": (3,), "Tensor": (9,)}[kind])
        found[attribute.get("Name")] = values
    assert np.array_equal(found["kinetic density"], fields["kinetic/density"])
    if d == 3:
        assert np.array_equal(found["fluid velocity"], fields["fluid/velocity"])
        assert np.array_equal(found["kinetic stress"], fields["kinetic/stress"].reshape(ny, nx, 9))
    else:
        assert np.array_equal(found["kinetic heat flux x"], fields["kinetic/heat_flux"][..., 0])
        assert np.array_equal(
            found[f"kinetic stress x{'xy'[d - 1]}"], fields["kinetic/stress"][..., 0, d - 1]
        )
        assert "kinetic stress yx" not in found
    assert grids[1].find("Topology").get("Dimensions") == f"{ny + 1} {nx + 1}"
    nodes = [np.array(item.text.split(), dtype=float) for item in grids[1].findall("Geometry/DataItem")]
    assert [len(n) for n in nodes] == [nx + 1, ny + 1]
    if cells:
        assert (nodes[0][0], nodes[0][-1]) == pytest.approx((-1.0, 1.0))
    if len(cells) == 2:
        assert (nodes[1][0], nodes[1][-1]) == pytest.approx((2.0, 3.0))


def test_xdmf_grows_by_what_is_new_and_is_whole_after_each_snapshot(tmp_path):
    times = [0.1 * k for k in range(40)]
    job, path = make_job(times=times), tmp_path / "fields.xdmf"
    description = Xdmf(path, job, [math.nan] * 40)
    assert not path.exists()
    file = None
    for index, time in enumerate(times):
        description.add(index, time)
        assert [float(e.get("Value")) for e in ET.parse(path).iter("Time")] == times[: index + 1]
        file = file or path.stat().st_ino
        assert path.stat().st_ino == file  # no new one
    Xdmf(tmp_path / "whole", job, times)
    assert path.read_bytes() == (tmp_path / "whole").read_bytes()
    description.add(7, times[7])  # taken anew
    assert path.read_bytes() == (tmp_path / "whole").read_bytes()
    # a later one is there already, somebody has cut the file off, or it is gone
    some = [*times[:20], math.nan, *times[21:]]
    for harm in (lambda: None, lambda: os.truncate(path, 100), path.unlink):
        description = Xdmf(path, job, some)
        harm()
        description.add(20, times[20])
        assert path.read_bytes() == (tmp_path / "whole").read_bytes()


def test_xdmf_is_as_before_where_the_disk_takes_no_more(tmp_path):
    import resource
    import signal

    job, path = make_job(), tmp_path / "fields.xdmf"
    description = Xdmf(path, job, [math.nan] * 3)
    description.add(0, 0.0)
    before = path.read_bytes()
    limits, heed = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 100, limits[1]))
    try:
        with pytest.raises(OSError, match=r"fields\.xdmf cannot be written: File too large"):
            description.add(1, 0.5)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, heed)
    assert path.read_bytes() == before
    description.add(1, 0.5)
    assert [float(e.get("Value")) for e in ET.parse(path).iter("Time")] == [0.0, 0.5]


COLUMNS = ("step", "time", "mass", "min_g")


def history_row(step):
    return {"mass": 1 / 3 + step, "time": 0.1 * step, "min_g": -1e-17, "step": step}


def test_history_reads_back_to_the_last_bit(tmp_path):
    history = History(tmp_path / "history.csv", COLUMNS)
    for step in (0, 1, 2):
        history.append(history_row(step))
        rows = list(csv.DictReader((tmp_path / "history.csv").open()))
        assert len(rows) == step + 1  # each row is in the file as soon as it is appended
    history.close()
    assert list(rows[2]) == list(COLUMNS)
    assert rows[2]["step"] == "2"
    assert {name: float(value) for name, value in rows[2].items()} == history_row(2)
    columns = results.read_history(tmp_path)
    assert columns["mass"].tolist() == [history_row(step)["mass"] for step in (0, 1, 2)]


def test_history_writes_numpy_numbers_and_nan_plainly(tmp_path):
    history = History(tmp_path / "history.csv", COLUMNS)
    history.append({"step": np.int64(4), "time": np.float64(0.1), "mass": np.float32(0.5), "min_g": np.nan})
    history.close()
    assert (tmp_path / "history.csv").read_text() == "step,time,mass,min_g\n4,0.1,0.5,nan\n"


@pytest.mark.parametrize("row", [{"step": 1}, {**history_row(1), "more": 1.0}])
def test_history_refuses_other_columns(tmp_path, row):
    history = History(tmp_path / "history.csv", COLUMNS)
    with pytest.raises(ValueError, match="missing or unknown"):
        history.append(row)
    history.close()


@pytest.mark.parametrize("columns", [("step", "a,b"), ("step", "a b"), ("step", "step"), ("step", "")])
def test_history_refuses_columns_that_break_a_csv_file(tmp_path, columns):
    with pytest.raises(ValueError, match="columns of a CSV"):
        History(tmp_path / "history.csv", columns)


def test_history_goes_on_after_a_restart(tmp_path):
    path = tmp_path / "history.csv"
    history = History(path, COLUMNS)
    for step in range(5):
        history.append(history_row(step))
    history.close()
    with path.open("a") as file:
        file.write("5,0.5,1.2")  # cut off in mid-write
    assert results.read_history(tmp_path)["step"].tolist() == [0, 1, 2, 3, 4]
    history = History(path, COLUMNS, resume_after=2)
    history.append(history_row(3))
    history.close()
    assert results.read_history(tmp_path)["step"].tolist() == [0, 1, 2, 3]
    with pytest.raises(ValueError, match="other columns"):
        History(path, ("step", "time"), resume_after=2)
    assert results.read_history(tmp_path)["step"].tolist() == [0, 1, 2, 3]


def test_a_history_cut_back_is_on_disk_before_it_takes_the_place_of_the_old_one(tmp_path, monkeypatch):
    events = []
    fsync, replace = os.fsync, Path.replace

    def note_fsync(descriptor):
        events.append((Path(f"/proc/self/fd/{descriptor}").readlink().name, os.fstat(descriptor).st_size))
        fsync(descriptor)

    def note_replace(self, target):
        events.append((f"{self.name} to {target.name}", self.stat().st_size))
        return replace(self, target)

    history = History(tmp_path / "history.csv", COLUMNS)
    history.append(dict.fromkeys(COLUMNS, 1.0))
    history.close()
    monkeypatch.setattr(os, "fsync", note_fsync)
    monkeypatch.setattr(Path, "replace", note_replace)
    History(tmp_path / "history.csv", COLUMNS, resume_after=0).close()
    size = len(",".join(COLUMNS)) + 1
    assert events == [("history.csv.part", size), ("history.csv.part to history.csv", size)]


def test_a_row_that_cannot_be_written_names_the_file_and_is_not_tried_again(tmp_path):
    history = History(tmp_path / "history.csv", COLUMNS)
    history._file.close()
    history._file = Path("/dev/full").open("ab", buffering=0)  # noqa: SIM115
    with pytest.raises(OSError, match=r"history\.csv cannot be written: No space left on device"):
        history.append(dict.fromkeys(COLUMNS, 1.0))
    history.close()


def test_a_new_history_starts_empty(tmp_path):
    for _ in range(2):
        history = History(tmp_path / "history.csv", COLUMNS)
        history.append(history_row(1))
        history.close()
    assert results.read_history(tmp_path)["step"].tolist() == [1]
