"""The commands of `rvm`: they parse and print, and compute nothing.

A job is read and checked before PETSc and MPI are imported, on every rank, so that a wrong request ends at
once.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from rvm_mpi import __version__, terminal
from rvm_mpi.commands import check, compile, run
from rvm_mpi.commands.arguments import EXIT_STATUS, count, tolerance
from rvm_mpi.job.text import JobError
from rvm_mpi.run import failures
from rvm_mpi.run.launch import check_world


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
    commands = parser.add_subparsers(dest="command", required=True, metavar="run|check|info|compare|compile|bench")
    run.add(commands)
    check.add(commands)
    info = commands.add_parser("info", help="what a run directory holds", allow_abbrev=False)
    info.add_argument("directory", metavar="DIR", type=Path)
    info.set_defaults(function=_info)
    _add_compare(commands)
    compile.add(commands)
    bench = commands.add_parser("bench", help="throughput of the step on this machine", allow_abbrev=False)
    bench.add_argument("--cells", nargs=2, type=count, metavar=("NX", "NY"), default=[64, 64])
    bench.add_argument("--velocity", nargs=3, type=count, metavar=("NX", "NY", "NZ"), default=[24, 24, 8])
    bench.add_argument("--json", action="store_true", help="print the figures as JSON")
    bench.set_defaults(function=_bench)
    return parser


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
        "--tolerance", metavar="R", type=tolerance, help="largest difference relative to a quantity's size [the bits]"
    )
    compare.set_defaults(function=_compare)


def _info(options: argparse.Namespace) -> int:
    from rvm_mpi.commands.info import describe_run
    from rvm_mpi.output import rundir

    path = options.directory
    if not path.is_dir() or not rundir.holds_run(path):
        raise JobError(f"{path}: {'holds no run' if path.is_dir() else 'no such directory'}")
    terminal.answer("\n".join(describe_run(path)))
    return 0


def _compare(options: argparse.Namespace) -> int:
    from rvm_mpi.output.compare import compare_paths

    same, lines = compare_paths(options.a, options.b, options.tolerance)
    terminal.answer("\n".join(lines))
    return 0 if same else 1


def _bench(options: argparse.Namespace) -> int:
    from rvm_mpi.commands.bench import run_bench

    check_world()
    return run_bench(cells=tuple(options.cells), velocity=tuple(options.velocity), as_json=options.json)
