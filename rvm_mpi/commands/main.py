"""The commands `rvm run`, `rvm check`, `rvm info` and `rvm bench`: they parse and print, and compute nothing.

A job is read and checked before PETSc and MPI are imported, on every rank, so that a wrong request ends at
once.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator, Sequence
from math import inf, isnan, nan, prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from rvm_mpi import __version__
from rvm_mpi.job.text import JobError, one_line
from rvm_mpi.run import failures, terminal
from rvm_mpi.run.launch import check_world, launched

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

EXIT_STATUS = (
    "exit status: 0 done; 2 the request is wrong, nothing was run; 3 the run failed; "
    "75 stopped early with a checkpoint, go on with --restart"
)


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one line, like a job file's."""

    def error(self, message: str) -> NoReturn:
        raise JobError(f"{message} (see {self.prog} --help)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns its exit status (0, 1, 2, 3 or 75)."""
    terminal.prepare()
    try:
        try:
            options = _parser().parse_args(arguments)
        except BrokenPipeError:  # the reader of --help has gone
            return 0
        return int(options.function(options))
    except JobError as error:
        return failures.refuse(error)
    except KeyboardInterrupt:
        return failures.interrupted()
    except Exception as error:
        return failures.fail(error)
    finally:
        terminal.flush()  # --help leaves its text to the end of the program


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="rvm",
        allow_abbrev=False,
        description="Rescaled kinetic equations for dissipative and rarefied gases, in parallel.",
        epilog=EXIT_STATUS,
    )
    parser.add_argument("--version", action="version", version=f"rvm {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="run|check|info|compare|bench")
    _add_run(commands)
    _add_check(commands)
    info = commands.add_parser("info", help="what a run directory holds", allow_abbrev=False)
    info.add_argument("directory", metavar="DIR", type=Path)
    info.set_defaults(function=_info)
    _add_compare(commands)
    bench = commands.add_parser("bench", help="throughput of the step on this machine", allow_abbrev=False)
    bench.add_argument("--cells", nargs=2, type=_count, metavar=("NX", "NY"), default=[64, 64])
    bench.add_argument("--velocity", nargs=3, type=_count, metavar=("NX", "NY", "NZ"), default=[24, 24, 8])
    bench.add_argument("--json", action="store_true", help="print the figures as JSON")
    bench.set_defaults(function=_bench)
    return parser


def _add_run(commands: Any) -> None:
    run = commands.add_parser(
        "run", help="run a job, alone or under mpirun", allow_abbrev=False, epilog=EXIT_STATUS
    )
    run.add_argument("job", metavar="JOB.toml")
    run.add_argument("--output", metavar="DIR", type=Path, help="run directory [runs/<name of the job file>]")
    _add_set(run)
    run.add_argument("--restart", action="store_true", help="go on from the last checkpoint in DIR")
    run.add_argument(
        "--overwrite", action="store_true", help="move a run in DIR aside first; it is never deleted"
    )
    run.add_argument("--walltime", metavar="HH:MM:SS", type=_walltime, help="stop before, with a checkpoint")
    run.add_argument("--quiet", action="store_true", help="no progress line")
    run.set_defaults(function=_run)


def _add_check(commands: Any) -> None:
    check = commands.add_parser(
        "check", help="validate a job and estimate its run; runs nothing", allow_abbrev=False
    )
    check.add_argument("job", metavar="JOB.toml", nargs="?")
    _add_set(check)
    check.add_argument("--ranks", metavar="N", type=_count, help="number of MPI ranks to plan for [1]")
    check.add_argument("--states", action="store_true", help="list the initial states and their keys")
    check.set_defaults(function=_check)


def _add_compare(commands: Any) -> None:
    compare = commands.add_parser(
        "compare",
        help="whether two runs, or two checkpoints, are the same",
        allow_abbrev=False,
        epilog="exit status: 0 the same; 1 not the same; 2 they cannot be compared",
    )
    compare.add_argument("a", metavar="A", type=Path, help="run directory or checkpoint")
    compare.add_argument("b", metavar="B", type=Path, help="run directory or checkpoint")
    compare.add_argument(
        "--tolerance", metavar="R", type=_tolerance, help="largest difference relative to a quantity's size [the bits]"
    )
    compare.set_defaults(function=_compare)


def _add_set(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set", metavar="KEY=VALUE", action="append", default=[],
        help="override one key of the job file, for instance collision.restitution=0.75 (TOML syntax)",
    )  # fmt: skip


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return int(text)


def _tolerance(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not 0.0 <= value < inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 on")
    return value


def _walltime(text: str) -> float:
    match = re.fullmatch(r"(?:(\d+)-)?(\d+):([0-5]\d):([0-5]\d)", text)
    seconds = 0
    if match:
        days, hours, minutes, rest = (int(part or 0) for part in match.groups())
        seconds = ((days * 24 + hours) * 60 + minutes) * 60 + rest
    if seconds == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a time HH:MM:SS above zero")
    return float(seconds)


# --- run


def _output(options: argparse.Namespace) -> Path:
    return options.output or Path("runs") / Path(options.job).stem


def _run(options: argparse.Namespace) -> int:
    from rvm_mpi.advice.memory import check_weights
    from rvm_mpi.advice.start import check_start
    from rvm_mpi.grid.domain import partition
    from rvm_mpi.job.checks import check_source
    from rvm_mpi.job.job import Job
    from rvm_mpi.output import rundir

    job = Job.from_file(options.job, options.set)
    output = _output(options)
    rundir.check(output, options.restart, options.overwrite)
    if options.restart:
        rundir.check_restart(output, job)  # of the start nothing is looked at: the checkpoint holds it
        check_weights(job)
        partition(job.space.cells, launched().size)
    else:
        check_source(job, options.job, options.set)
        check_start(job, launched().size)
    check_world()

    from rvm_mpi.simulation import run_job

    return run_job(
        job,
        output=output,
        restart=options.restart,
        overwrite=options.overwrite,
        walltime=options.walltime,
        quiet=options.quiet,
    )


# --- check


def _check(options: argparse.Namespace) -> int:
    from rvm_mpi.states import describe_states

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
    from rvm_mpi.job.checks import check_source
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
    if job.scaling.kind != "none" and mach < inf:
        yield _row(
            "  flows up to",
            f"Mach {mach:.3g}: faster ones leave too little of omega^2 to T_g; with every Gaussian exact, up to Mach "
            f"{mach_carried(job):.3g}",
        )


def _accuracy_lines(job: Job) -> Iterator[str]:
    from rvm_mpi.advice import accuracy, conduction

    for describe in (accuracy.describe, conduction.describe):
        yield from (_row(name, text) for name, text in describe(job))


def _watch_lines(job: Job) -> Iterator[str]:
    from rvm_mpi.run.watch import promised

    watch = job.watch
    stop = f"a stop above {watch.box_stop:g}" if watch.box_stop < 1.0 else "no stop"
    kept = ", ".join(name.removesuffix("_error") for name in promised(job))
    yield _row("watched", f"outermost velocities: a warning above {watch.box_warning:g} of a cell's gas, {stop}")
    yield _row("  balances", f"{kept}: a warning above {watch.balance:g}, relative")


# --- info, compare and bench


def _info(options: argparse.Namespace) -> int:
    from rvm_mpi.commands.info import describe_run
    from rvm_mpi.output import rundir

    path = options.directory
    if not path.is_dir() or not rundir.holds_run(path):
        raise JobError(f"{path}: {'holds no run' if path.is_dir() else 'no such directory'}")
    terminal.answer("\n".join(describe_run(path)))
    return 0


def _compare(options: argparse.Namespace) -> int:
    from rvm_mpi.commands.compare import compare_paths

    same, lines = compare_paths(options.a, options.b, options.tolerance)
    terminal.answer("\n".join(lines))
    return 0 if same else 1


def _bench(options: argparse.Namespace) -> int:
    from rvm_mpi.commands.bench import run_bench

    check_world()
    return run_bench(cells=tuple(options.cells), velocity=tuple(options.velocity), as_json=options.json)
