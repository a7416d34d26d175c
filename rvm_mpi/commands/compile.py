"""The command `rvm compile`."""

from __future__ import annotations

import argparse
from typing import Any

from rvm_mpi import terminal


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser(
        "compile",
        help="compile all kernels, so that later runs start at once",
        allow_abbrev=False,
        epilog="a minute, once for a version and a kind of processor; under mpirun one rank of each node does it",
    )
    parser.set_defaults(function=_compile)


def _compile(_: argparse.Namespace) -> int:
    from mpi4py import MPI

    from rvm_mpi.compiling.declare import all_compiled, kept_in
    from rvm_mpi.run.warm import prepare

    head = MPI.COMM_WORLD.rank == 0
    if kept_in() is None:
        if head:
            terminal.answer("there is no place to keep kernels (set NUMBA_CACHE_DIR): nothing is compiled")
        return 0
    prepare(MPI.COMM_WORLD, terminal.tell if head else lambda _: None)
    if head and all_compiled():
        terminal.answer(f"the kernels are compiled, in {kept_in()}")
    return 0
