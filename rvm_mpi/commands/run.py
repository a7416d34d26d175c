"""`rvm run`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from rvm_mpi.commands.arguments import EXIT_STATUS, add_set, walltime
from rvm_mpi.run.launch import check_world, launched


def add(commands: Any) -> None:
    """The arguments of `rvm run`."""
    parser = commands.add_parser(
        "run", help="run a job, alone or under mpirun", allow_abbrev=False, epilog=EXIT_STATUS
    )
    parser.add_argument("job", metavar="JOB.toml")
    parser.add_argument("--output", metavar="DIR", type=Path, help="run directory [runs/<name of the job file>]")
    add_set(parser)
    parser.add_argument("--restart", action="store_true", help="go on from the last checkpoint in DIR")
    parser.add_argument(
        "--overwrite", action="store_true", help="move a run in DIR aside first; it is never deleted"
    )
    parser.add_argument("--walltime", metavar="HH:MM:SS", type=walltime, help="stop before, with a checkpoint")
    parser.add_argument("--quiet", action="store_true", help="no progress line")
    parser.set_defaults(function=run)


def _output(options: argparse.Namespace) -> Path:
    return options.output or Path("runs") / Path(options.job).stem


def run(options: argparse.Namespace) -> int:
    """Check the job and the directory on every rank, start MPI, run; the exit status."""
    from rvm_mpi.advice.memory import check_weights
    from rvm_mpi.advice.start import check_start
    from rvm_mpi.grid.domain import partition
    from rvm_mpi.job.check_initial import check_source
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

    from rvm_mpi.run.run import run_job

    return run_job(
        job,
        output=output,
        restart=options.restart,
        overwrite=options.overwrite,
        walltime=options.walltime,
        quiet=options.quiet,
    )
