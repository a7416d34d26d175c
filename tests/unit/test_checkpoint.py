"""Checkpoints on one rank: the same bits, every damage noticed, and the last good one used."""

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from rvm_mpi.agree import DiskFailure
from rvm_mpi.job.job import Job, JobError
from rvm_mpi.output import checkpoint, fields, rundir
from rvm_mpi.output.compare import compare_paths
from rvm_mpi.output.restart import Checkpoint, DamagedCheckpoint, use_newest
from rvm_mpi.results import open_run
from rvm_mpi.run.run import run_job
from rvm_mpi.simulation import Simulation


def make_job(cells=(6,), **tables):
    sides = {"boundary": {"x": {"lower": {"kind": "maxwell", "accommodation": 0.5}, "upper": "far-field"}}}
    return Job.from_dict(
        {
            "space": {"cells": list(cells), **(sides if cells else {})},
            "velocity": {"points": [12, 10]},
            "collision": {"operator": "granular-es-bgk", "knudsen": 0.2, "restitution": 0.9},
            "fluid": {"enabled": True},
            "initial": {"state": "random-density", "low": 0.5} if cells else {"state": "uniform"},
            "time": {"end": 1.0, "max_steps": 4},
            **tables,
        }
    )


def bits(simulation):
    """All bytes of a simulation's state."""
    state = simulation.state()
    cells = {name: array.tobytes() for name, array in state.cells.items()}
    sides = {name: array.tobytes() for name, array in state.sides.items()}
    return state.g.tobytes(), cells, sides, json.dumps(state.numbers)  # NaN is NaN in text


def files(directory):
    return sorted(path.name for path in directory.iterdir())


def save(simulation, directory):
    return checkpoint.write(simulation.state(), simulation.domain, simulation.job, directory, simulation.number)


def load(job, directory):
    return use_newest(directory, MPI.COMM_WORLD, lambda found: Simulation(job, restart=found))


def stepped(job, steps, initial=None):
    simulation = Simulation(job, initial)
    for _ in range(steps):
        simulation.advance()
    return simulation


@pytest.mark.parametrize("cells", [(), (6,), (4, 5)])
def test_a_restart_goes_on_with_the_same_bits(tmp_path, cells):
    job = make_job(cells)
    simulation = stepped(job, 2)
    save(simulation, tmp_path)
    other, said = load(job, tmp_path)
    assert bits(other) == bits(simulation)
    assert said == []
    for _ in range(2):
        simulation.advance()
        other.advance()
    assert bits(other) == bits(simulation)
    assert other.number == 4


def test_a_restart_needs_the_initial_state_from_nowhere_else(tmp_path):
    """Far fields keep it, balances refer to it: both come from the checkpoint."""
    job = make_job()

    def initial(x, y):
        return 1.0 + 0.3 * np.sin(7.0 * x), 0.1, 1.0 + 0.2 * x

    simulation = stepped(job, 2, initial)
    save(simulation, tmp_path)
    other, _ = load(job, tmp_path)
    simulation.advance()
    other.advance()
    assert bits(other) == bits(simulation)
    from_the_job = stepped(job, 3)
    assert bits(other)[0] != bits(from_the_job)[0]


def test_the_last_two_are_kept(tmp_path):
    simulation = Simulation(make_job())
    for _ in range(4):
        simulation.advance()
        save(simulation, tmp_path)
    assert files(tmp_path) == ["checkpoint-00000003.h5", "checkpoint-00000004.h5"]


def test_checksums_belong_to_cells_not_to_blocks():
    g = np.random.default_rng(1).random((5, 7, 24))
    whole = checkpoint.checksums(g)
    assert np.array_equal(whole[1:3, 2:], checkpoint.checksums(g[1:3, 2:]))
    g[2, 3, 5] = np.nextafter(g[2, 3, 5], 1.0)
    assert np.argwhere(whole != checkpoint.checksums(g)).tolist() == [[2, 3]]


def test_no_call_moves_more_than_the_limit(tmp_path, monkeypatch):
    """Rows longer than the limit are cut into pieces of whole cells."""
    job = make_job((4, 5))
    simulation = stepped(job, 1)
    block = simulation.state().g.shape[-1]
    monkeypatch.setattr(checkpoint, "CALL", 3 * 8 * block + 100)
    assert list(checkpoint.pieces(simulation.state().g))[:3] == [(0, 0, 3), (0, 3, 1), (1, 0, 3)]
    save(simulation, tmp_path)
    assert bits(load(job, tmp_path)[0]) == bits(simulation)


def test_on_disk_before_it_has_its_name(tmp_path, monkeypatch):
    simulation = stepped(make_job(), 1)
    events = []
    fsync, replace = os.fsync, Path.replace

    def note_fsync(descriptor):
        events.append(f"fsync {Path(f'/proc/self/fd/{descriptor}').readlink().name}")
        fsync(descriptor)

    def note_replace(self, target):
        events.append(f"rename {self.name} {target.name}")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", note_fsync)
    monkeypatch.setattr(Path, "replace", note_replace)
    name = save(simulation, tmp_path).name
    last_write = [f"fsync {name}.part", f"rename {name}.part {name}", f"fsync {tmp_path.name}"]
    assert events[-3:] == last_write
    assert events[:-3].count(f"fsync {name}.part") >= 1  # the data, before they are called complete


def damaged_copies(path, tmp_path):
    """Files with one bit wrong, at places all over the file, and files cut off."""
    data = path.read_bytes()
    for place in [*range(0, 200, 3), *range(200, len(data), max(1, len(data) // 150))]:
        wrong = bytearray(data)
        wrong[place] ^= 1 << (place % 8)
        yield f"bit of byte {place}", bytes(wrong)
    for length in (0, 1, 100, len(data) // 2, len(data) - 1):
        yield f"cut to {length}", data[:length]


def test_no_damage_goes_unnoticed(tmp_path):
    """Whatever byte is wrong: the checkpoint is refused, or what is read has the same bits."""
    job = make_job(())
    simulation = stepped(job, 1)
    path = save(simulation, tmp_path)
    wanted, refused, harmless = bits(simulation), 0, []
    target = Simulation(job)
    for what, data in damaged_copies(path, tmp_path):
        path.write_bytes(data)
        try:
            with Checkpoint(path, MPI.COMM_WORLD) as found:
                found.check_job(job)
                found.fill(target.state(), target.domain)
                target._set_numbers(found.numbers)
            assert bits(target) == wanted, what
            harmless.append(what)
        except DamagedCheckpoint as error:
            assert str(error).startswith(f"{path} is damaged: ")
            assert "\n" not in str(error)
            refused += 1
    assert refused > 100
    assert not [what for what in harmless if what.startswith("cut")]


@pytest.mark.parametrize("damage", ["bit of g", "bit of cells", "cut", "not complete"])
def test_the_one_before_is_used_and_the_damaged_one_named(tmp_path, damage):
    import h5py

    job = make_job()
    simulation = stepped(job, 2)
    good = save(simulation, tmp_path)
    wanted = bits(simulation)
    simulation.advance()
    bad = save(simulation, tmp_path)
    if damage == "cut":
        os.truncate(bad, bad.stat().st_size - 500)
    else:
        with h5py.File(bad, "r+") as file:
            if damage == "not complete":
                file["complete"][()] = 0
            else:
                dataset = file[damage.split()[-1]]
                value = dataset[0, 3, 2]
                dataset[0, 3, 2] = np.nextafter(value, value + 1.0)
    other, said = load(job, tmp_path)
    assert bits(other) == wanted
    assert len(said) == 2
    assert said[0].startswith(f"{bad} is damaged: ")
    assert said[1] == f"going on from {good}, the one before"
    if "bit" in damage:
        assert "checksum of cell (3, 0)" in said[0]
    assert files(tmp_path) == [good.name, f"{bad.name}.damaged"]


def test_all_damaged_is_refused_and_left_alone(tmp_path):
    job = make_job()
    simulation = stepped(job, 1)
    path = save(simulation, tmp_path)
    os.truncate(path, 700)
    with pytest.raises(JobError, match=r"nothing to restart from: .*checkpoint-00000001.h5 is damaged"):
        load(job, tmp_path)
    assert files(tmp_path) == [path.name]


def test_half_written_is_named_and_not_used(tmp_path):
    job = make_job()
    simulation = stepped(job, 1)
    path = save(simulation, tmp_path)
    half = tmp_path / "checkpoint-00000002.h5.part"
    shutil.copy(path, half)
    other, said = load(job, tmp_path)
    assert other.number == 1
    assert said == [f"{half} was left half-written and is not used"]
    assert files(tmp_path) == [path.name]
    path.rename(half)
    with pytest.raises(JobError, match=r"no checkpoint; checkpoint-00000002.h5.part is half-written"):
        load(job, tmp_path)


def test_another_jobs_checkpoint_is_refused_with_the_keys(tmp_path):
    simulation = stepped(make_job(), 1)
    save(simulation, tmp_path)
    other = make_job(
        collision={"operator": "granular-es-bgk", "knudsen": 0.3, "restitution": 0.9},
        initial={"state": "random-density", "low": 0.5, "seed": 3},
    )
    with pytest.raises(JobError, match=r"another job: collision\.knudsen is 0\.3, was 0\.2; initial\.seed is 3"):
        load(other, tmp_path)
    longer = make_job(title="longer", time={"end": 7.0}, output={"times": [3.0, 7.0]})
    assert load(longer, tmp_path)[0].number == 1


def test_a_disk_without_room_leaves_the_earlier_ones(tmp_path, monkeypatch):
    simulation = stepped(make_job(), 1)
    path = save(simulation, tmp_path)
    before = path.read_bytes()
    real = os.statvfs(tmp_path)
    full = os.statvfs_result([*real[:3], 1, 1, *real[5:]])
    monkeypatch.setattr(os, "statvfs", lambda _path: full)
    simulation.advance()
    with pytest.raises(DiskFailure, match=r"checkpoint-00000002.h5 cannot be written: .*No space left"):
        save(simulation, tmp_path)
    assert files(tmp_path) == [path.name]
    assert path.read_bytes() == before


# -- a run directory --------------------------------------------------------------------------------------


def rows(directory):
    return (directory / "history.csv").read_text().splitlines()


def times(directory):
    import h5py

    with h5py.File(directory / "fields.h5", "r") as file:
        return [t if np.isfinite(t) else None for t in file["time"][()].tolist()]


def there(directory):
    """Times of the snapshots that exist."""
    return [t for t in times(directory) if t is not None]


def density_at(directory, time):
    return open_run(directory).kinetic_density.sel(time=time).values


def test_a_snapshot_written_because_the_run_stopped_stays_when_it_goes_on(tmp_path):
    directory = tmp_path / "run"
    job = make_job(output={"times": [0.0, 0.9, 1.0]})
    assert run_job(job, directory, quiet=True) == 0
    stored = times(directory)
    assert stored[0] == 0.0
    assert 0.0 < stored[1] < 0.9
    assert stored[1] == float(rows(directory)[-1].split(",")[1])
    assert repr(stored[1])[:12] in (directory / "fields.xdmf").read_text()
    first = density_at(directory, stored[1])
    # going nowhere changes nothing
    assert run_job(job, directory, restart=True, quiet=True) == 0
    assert there(directory) == stored[:2]
    longer = make_job(output={"times": [0.0, 0.9, 1.0]}, time={"end": 1.0, "max_steps": 6})
    assert run_job(longer, directory, restart=True, quiet=True) == 0
    assert there(directory)[:2] == stored[:2]
    assert there(directory)[2] > stored[1]
    assert times(directory)[3:] == [None]
    assert np.array_equal(density_at(directory, stored[1]), first)
    assert [line.split(",")[0] for line in rows(directory)[1:]] == [str(n) for n in range(7)]
    # beside an undisturbed run it is said, and no difference
    whole = tmp_path / "whole"
    assert run_job(longer, whole, quiet=True) == 0
    same, lines = compare_paths(whole, directory)
    assert same
    assert lines[0].startswith("fields.h5: snapshot 1 (t = ")
    assert lines[0].endswith("is in the second only, left where that run once stopped")


def test_a_run_that_is_extended_keeps_its_old_end_and_what_is_no_longer_asked_for(tmp_path):
    directory = tmp_path / "run"
    steps = {"max_steps": 1000}
    first = make_job(time={"end": 0.02, **steps}, output={"times": [0.01, 0.02], "marginals": True})
    assert run_job(first, directory, quiet=True) == 0
    before = open_run(directory)
    longer = make_job(time={"end": 0.04, **steps}, output={"times": [0.03, 0.04]})
    assert run_job(longer, directory, restart=True, quiet=True) == 0
    assert times(directory) == [0.01, 0.02, 0.03, 0.04]
    described = re.findall('Time Value="(.*?)"', (directory / "fields.xdmf").read_text())
    assert there(directory) == [float(t) for t in described]
    now = open_run(directory)
    for name in before.data_vars:
        assert np.array_equal(before[name].values, now[name].values[:2], equal_nan=True), name
    assert np.isnan(now.marginal_x.values[2:]).all()
    # with the default for the times, twice
    for end in (0.05, 0.06):
        assert run_job(make_job(time={"end": end, **steps}), directory, restart=True, quiet=True) == 0
    assert times(directory) == [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]


def test_a_snapshot_later_than_the_checkpoint_stays_until_it_is_taken_anew(tmp_path):
    """The run was killed after a snapshot, its last checkpoint was before; then another job's times go on."""
    directory = tmp_path / "run"

    def job(steps, *wanted):
        return make_job(output={"times": [0.0, *wanted, 1.0]}, time={"end": 1.0, "max_steps": steps})

    assert run_job(job(3, 0.5), directory, quiet=True) == 0
    end = there(directory)[-1]
    saved = min(directory.glob("checkpoint-*"))
    assert run_job(job(6, 0.5), directory, restart=True, quiet=True) == 0
    later = there(directory)[-1]
    kept = density_at(directory, later)
    for path in directory.glob("checkpoint-*"):
        if path != saved:
            path.unlink()
    assert run_job(job(3), directory, restart=True, quiet=True) == 0
    assert there(directory) == [0.0, end, later]
    assert np.array_equal(density_at(directory, later), kept)
    assert run_job(job(5), directory, restart=True, quiet=True) == 0
    assert there(directory)[:2] == [0.0, end]
    assert there(directory)[-1] == later
    assert run_job(job(1000), directory, restart=True, quiet=True) == 0
    assert there(directory)[-2:] == [later, 1.0]


@pytest.mark.parametrize("fault", ["no room", "a row that cannot be copied"])
def test_no_snapshot_is_lost_where_the_disk_has_no_room_for_more(tmp_path, monkeypatch, fault):
    directory = tmp_path / "run"
    job = make_job(output={"times": [0.0, 0.9]})
    assert run_job(job, directory, quiet=True) == 0
    before = (directory / "fields.h5").read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    owner, name = (fields, "check_room") if fault == "no room" else (os, "fsync")
    with monkeypatch.context() as patch:
        patch.setattr(owner, name, full if fault == "no room" else fails_on_fields(full))
        more = make_job(output={"times": [0.0, 0.8, 0.9]})
        assert run_job(more, directory, restart=True, quiet=True) == 3
    assert (directory / "fields.h5").read_bytes() == before
    assert not [p.name for p in directory.iterdir() if ".new" in p.name or ".part" in p.name]
    (directory / "fields.h5.new").write_text("left by a restart that was killed")
    assert run_job(more, directory, restart=True, quiet=True) == 0
    assert times(directory)[0] == 0.0
    assert len(times(directory)) == 4
    assert not (directory / "fields.h5.new").exists()


def fails_on_fields(full):
    """Flushing the copy to disk fails, and nothing else."""
    real = os.fsync

    def fsync(descriptor):
        if Path(f"/proc/self/fd/{descriptor}").readlink().name == "fields.h5.new":
            full()
        real(descriptor)

    return fsync


def test_overwriting_the_directory_one_stands_in_leaves_the_old_run_whole(tmp_path, monkeypatch):
    directory = tmp_path / "run"
    assert run_job(make_job(), directory, quiet=True) == 0
    before = {p.name: p.read_bytes() for p in directory.iterdir()}
    monkeypatch.chdir(directory)
    other = make_job(time={"end": 1.0, "max_steps": 2})
    assert run_job(other, Path(), overwrite=True, quiet=True) == 0
    assert {p.name: p.read_bytes() for p in (tmp_path / "run-old-1").iterdir()} == before
    assert len(rows(directory)) == 4


def test_times_may_be_added_but_not_behind_the_run(tmp_path):
    directory = tmp_path / "run"
    first = make_job(output={"times": [0.0, 0.005, 0.9]})
    run_job(first, directory, quiet=True)
    now = float(rows(directory)[-1].split(",")[1])
    assert now > 0.005
    before = {p.name: p.read_bytes() for p in directory.iterdir()}
    with pytest.raises(JobError, match=r"output.times: t = 0.007 was not stored before the checkpoint .*only later"):
        wanted = {"times": [0.0, 0.005, 0.007, 0.9]}
        run_job(make_job(output=wanted), directory, restart=True, quiet=True)
    with pytest.raises(JobError, match=r"time\.end = 0\.006 lies before the checkpoint"):
        run_job(make_job(time={"end": 0.006}, output={"times": [0.0, 0.005]}), directory, restart=True, quiet=True)
    assert {p.name: p.read_bytes() for p in directory.iterdir()} == before
    density = density_at(directory, 0.005)
    run_job(make_job(output={"times": [0.0, 0.8, 0.9]}), directory, restart=True, quiet=True)
    assert times(directory) == [0.0, 0.005, now, 0.8 if 0.8 in there(directory) else None, None]
    assert np.array_equal(density_at(directory, 0.005), density)
    assert np.isfinite(open_run(directory).wall_x_lower_pressure.values[2]).all()


def test_results_that_do_not_lead_to_the_checkpoint_are_refused(tmp_path):
    job = make_job()
    run_job(job, tmp_path, quiet=True)
    history = tmp_path / "history.csv"
    whole = history.read_text()
    history.write_text("".join(whole.splitlines(keepends=True)[:3]))
    with pytest.raises(JobError, match="not the history that leads to step 4"):
        run_job(job, tmp_path, restart=True, quiet=True)
    history.write_text(whole)
    (tmp_path / "fields.h5").unlink()
    with pytest.raises(JobError, match="cannot go on with its results"):
        run_job(job, tmp_path, restart=True, quiet=True)


def test_nothing_to_restart(tmp_path):
    with pytest.raises(JobError, match="holds no run"):
        run_job(make_job(), tmp_path, restart=True, quiet=True)
    rundir.prepare(tmp_path, make_job())
    with pytest.raises(JobError, match="no checkpoint"):
        run_job(make_job(), tmp_path, restart=True, quiet=True)


def test_checkpoints_by_the_clock(tmp_path):
    """Every step is more than a nanosecond: a checkpoint after each, the last two kept."""
    job = make_job(output={"checkpoint_every": "1e-9 s"})
    assert run_job(job, tmp_path, quiet=True) == 0
    assert [p.name for p in rundir.checkpoints(tmp_path)] == ["checkpoint-00000003.h5", "checkpoint-00000004.h5"]
    assert (tmp_path / "run.log").read_text().count("checkpoint of step") == 4
