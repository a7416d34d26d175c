"""`rvm check`: a job in words, without running it."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from math import inf, isnan, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rvm_mpi import terminal
from rvm_mpi.commands.arguments import add_set, count
from rvm_mpi.job.text import JobError, one_line
from rvm_mpi.run.launch import launched

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job
    from rvm_mpi.job.section import Section


def add(commands: Any) -> None:
    """The arguments of `rvm check`."""
    parser = commands.add_parser(
        "check", help="validate a job and estimate its run; runs nothing", allow_abbrev=False
    )
    parser.add_argument("job", metavar="JOB.toml", nargs="?")
    add_set(parser)
    parser.add_argument("--ranks", metavar="N", type=count, help="number of MPI ranks to plan for [1]")
    parser.add_argument("--states", action="store_true", help="list the initial states and their keys")
    parser.set_defaults(function=check)


def check(options: argparse.Namespace) -> int:
    """Print what a job comes to; 0 if it can run."""
    if not options.states and options.job is None:
        raise JobError("check: give a job file, or --states (see rvm check --help)")
    lines: list[str] = []
    if options.job is not None:
        from rvm_mpi.advice.memory import check_weights
        from rvm_mpi.advice.start import check_start
        from rvm_mpi.job.job import Job

        job = Job.from_file(options.job, options.set)
        starts, ranks = _starts(job, options), options.ranks or launched().size
        if starts:
            check_start(job, ranks)
        else:
            check_weights(job)
        lines += _check_lines(job, options.job, ranks, starts)
    if options.states:
        lines += [*([""] if lines else []), *describe_states()]
    terminal.answer("\n".join(lines))
    return 0


def _starts(job: Job, options: argparse.Namespace) -> bool:
    """Whether the run that a job's state comes from is there; JobError if not, but for a job that has started."""
    from rvm_mpi.job.check_initial import check_source
    from rvm_mpi.output import rundir

    try:
        check_source(job, options.job, options.set)
    except JobError:
        file = Path(options.job)
        if file.name == "job.toml" and rundir.checkpoints(file.parent):
            return False
        raise
    return True


def _check_lines(job: Job, file: str, ranks: int, starts: bool = True) -> Iterator[str]:
    from rvm_mpi.advice.verdicts import verdicts

    yield f"{file}: valid" + (f' ("{one_line(job.title)}")' if job.title else "")
    yield ""
    yield from _grid_lines(job, ranks)
    if starts:
        yield from _step_lines(job, ranks)
        yield from _physics_lines(job)
        yield from _velocity_lines(job)
        yield from _accuracy_lines(job)
    else:
        yield _row("initial state", "the run it came from is gone; --restart goes on from the checkpoint")
    yield from _watch_lines(job)
    for verdict in verdicts(job) if starts else ():
        yield _row("verdict", verdict)


def _row(name: str, text: str) -> str:
    return f"{name:<21} {text}"


def _grid_lines(job: Job, ranks: int) -> Iterator[str]:
    from rvm_mpi.advice import memory
    from rvm_mpi.grid.domain import largest_ranks, partition

    split = partition(job.space.cells, ranks)
    cells = " x ".join(map(str, job.space.cells)) or "1 (no space)"
    velocities = " x ".join(map(str, job.velocity.points))
    total = prod(job.space.cells) * prod(job.velocity.points)
    yield _row("grid", f"{cells} cells x {velocities} velocities = {total:.4g} phase-space cells")
    share = " x ".join(str(-(-n // p)) for n, p in zip(job.space.cells, split, strict=False)) or "1"
    most = largest_ranks(job.space.cells)
    yield _row(
        "decomposition", f"{split[0]} x {split[1]} ranks of at most {share} cells (at most {most} ranks)"
    )
    size = memory.memory(job, ranks)
    words = memory.bytes_in_words
    yield _row(
        "memory per rank",
        f"{words(size.total)}: distribution {words(size.g)}, fluxes {words(size.fluxes)}, "
        + (f"Boltzmann operator {words(size.operator)}, " if size.operator else "")
        + f"fields {words(size.fields)}, program and libraries {words(size.libraries)}",
    )
    if size.weights:
        yield _row(
            "  and once a node",
            f"{words(size.weights)} of Boltzmann weights, {memory.MAKING_WEIGHTS} times that while they are made",
        )


def _step_lines(job: Job, ranks: int) -> Iterator[str]:
    from rvm_mpi.advice import duration, first_step

    first = first_step.first_step(job)
    yield _row("first time step", f"{first.dt:.4g}, limited by {first.limit}")
    rates = f"transport {first.transport_rate:.4g}, drift {first.drift_rate:.4g}"
    if first.growth_rate > 0:
        rates += f" (of it {first.growth_rate:.4g} by d omega/dt)"
    yield _row("  rates", f"{rates}, cooling {first.cooling_rate:.4g}")
    if first.later > first.dt:
        yield _row("  later", f"up to {first.later:.4g}, when jumps of the initial state have smoothed out")
    number = duration.steps(job)
    yield _row("steps", f"at least {number:.0f} to t = {job.time.end:g}, as far as the initial state tells")
    triad = duration.triad_seconds()
    least = duration.duration_in_words(duration.run_seconds(job, ranks, triad))
    on = "a core" if ranks == 1 else f"{ranks} cores"
    yield _row("run time", f"at least {least} on {on} like this machine's (triad {1e9 * triad:.2f} ns an element)")


def _physics_lines(job: Job) -> Iterator[str]:
    from rvm_mpi.advice import physics
    from rvm_mpi.advice.verdicts import clustering_words

    gas = physics.physics(job)
    if gas is None:
        yield _row("collisions", "none: free transport")
        return
    yield _row("collision time", _range(gas.collision_time))
    yield _row("mean free path", _range(gas.mean_free_path))
    if not isnan(gas.knudsen):
        yield _row(
            "Knudsen number",
            f"{gas.knudsen:.4g}: mean free path of the mean state / {gas.length:g}, the shortest side"
            + ("" if all(map(job.space.periodic, range(job.space.dimensions))) else " between boundaries")
            + f" (collision.knudsen = {job.collision.knudsen:g})",
        )
        yield _row("cells per mean path", f"{gas.cells_per_mean_free_path:.3g} in the mean state")
    if gas.haff_time < inf:
        yield _row(
            "cooling", f"temperature falls to a quarter in t = {gas.haff_time:.4g} (Haff's law, mean state)"
        )
    words = clustering_words(job)
    if words:
        yield _row("linear stability", words)


def _range(values: Any) -> str:
    if values.high <= values.low * (1 + 1e-9):
        return f"{values.mean:.4g}"
    return f"{values.mean:.4g} on average by mass, in the cells {values.low:.4g} to {values.high:.4g}"


def _velocity_lines(job: Job) -> Iterator[str]:
    from rvm_mpi.advice import velocity_grid
    from rvm_mpi.advice.verdicts import mach_carried

    of = "T" if job.scaling.kind == "none" else "T_g"
    grid = list(zip("xyz", job.velocity.points, job.velocity.half_width, strict=False))
    least = ", ".join(f"{axis} {velocity_grid.least_temperature(n, width):.4g}" for axis, n, width in grid)
    sampled = ", ".join(f"{axis} {velocity_grid.sampling_limit(n, width):.4g}" for axis, n, width in grid)
    yield _row(f"smallest {of}", f"{velocity_grid.smallest_temperature(job):.4g}, along each direction {least}")
    yield _row(
        "  sampled within 1 %", f"down to {sampled}; below, Gaussians live on their discrete correction"
    )
    for line in velocity_grid.unresolved_sides(job):
        yield _row("  warning", line)
    mach = velocity_grid.largest_mach(job)
    if job.scaling.kind == "thermal":
        yield _row("  flows up to", "any Mach number: velocities are counted from the gas's own mean")
    elif job.scaling.kind != "none" and mach < inf:
        yield _row(
            "  flows up to",
            f"Mach {mach:.3g}: faster ones leave too little of omega^2 to T_g; with every Gaussian exact, up to Mach "
            f"{mach_carried(job):.3g}",
        )


def _accuracy_lines(job: Job) -> Iterator[str]:
    from rvm_mpi.advice import accuracy, conduction, cooling_state

    for describe in (accuracy.describe, conduction.describe, cooling_state.describe):
        yield from (_row(name, text) for name, text in describe(job))


def _watch_lines(job: Job) -> Iterator[str]:
    from rvm_mpi.run.watch import promised

    watch = job.watch
    stop = f"a stop above {watch.box_stop:g}" if watch.box_stop < 1.0 else "no stop"
    kept = ", ".join(name.removesuffix("_error") for name in promised(job))
    yield _row("watched", f"outermost velocities: a warning above {watch.box_warning:g} of a cell's gas, {stop}")
    yield _row("  balances", f"{kept}: a warning above {watch.balance:g}, relative")


# --- the initial states


def describe_states() -> Iterator[str]:
    """Lines that list every state with its keys, what is allowed and the defaults."""
    from rvm_mpi.job.initial import INITIAL_STATES

    for name, model in INITIAL_STATES.items():
        yield f"{name}: {_first_line(model)}"
        for key, field in model.model_fields.items():
            if key != "state":
                yield f"    {key}: {field.description} [{_default(name, key, field)}]"


def _first_line(model: type[Section]) -> str:
    return (model.__doc__ or "").strip().split("\n")[0]


def _default(name: str, key: str, field: Any) -> str:
    if field.is_required():
        return "must be given"
    if field.default is not None:
        return f"{field.default:.6g}" if isinstance(field.default, float) else str(field.default)
    return {
        "temperature": "1, or the mean of the stress tensor's diagonal",
        "velocity": "0",
        "velocity_amplitude": "0",
        "centre": "the middle",
        "position": "the middle",
        "mode": "1 along x",
        "time": "the last",
    }.get(key, "none")
