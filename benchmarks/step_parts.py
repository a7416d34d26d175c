"""Where the time of a step goes, on whatever ranks it is started on: sweep, halo, fluid, reductions, files.

    mpirun -n 2 --bind-to none .venv/bin/python benchmarks/step_parts.py [--cells 64 64] [--velocity 24 24 8]
    .venv/bin/python benchmarks/step_parts.py --job jobs/test2_classical.toml --steps 200

The run is that of `rvm run` with its files; the program's own functions are wrapped with timers here. A part's time
leaves out that of the parts within it. Waiting for other ranks counts where they wait: halo, reductions, diagnostics.
Medians over the steps, means over the ranks; snapshots and checkpoints apart, each the median of its own time.
"""

import argparse
import statistics
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

from mpi4py import MPI

from rvm_mpi.advice import first_step
from rvm_mpi.commands.bench import _job
from rvm_mpi.diagnostics import Diagnostics
from rvm_mpi.fluid import FluidSystem
from rvm_mpi.grid.domain import Domain
from rvm_mpi.job.job import Job
from rvm_mpi.run.control import Control
from rvm_mpi.run.run import Run, run_job
from rvm_mpi.run.watch import Watch
from rvm_mpi.simulation import Simulation
from rvm_mpi.step import ghosts, stepper

PARTS = {
    "sweep": [(stepper, "sweep")],
    "halo": [(Domain, "exchange")],
    "walls": [(ghosts, "fill_side")],
    "fluid": [(FluidSystem, "advance"), (FluidSystem, "max_rate"), (FluidSystem, "omega")],
    "reductions": [(Domain, "maximum")],
    "diagnostics": [(Diagnostics, "update")],
    "history, log, control": [
        (Run, "record"),
        (Run, "warn"),
        (Control, "agree"),
        (Watch, "reason_to_stop"),
    ],
    "snapshot": [(Run, "_write_snapshot")],
    "checkpoint": [(Run, "save")],
}


class Clock:
    """Times of parts within each step; a part stops while one within it runs."""

    def __init__(self) -> None:
        self.steps: list[Counter[str]] = []
        self.whole: defaultdict[str, list[float]] = defaultdict(list)
        self._now: Counter[str] = Counter()
        self._inside: list[str] = []
        self._since = time.perf_counter()

    def turn(self) -> None:
        """Give the time since the last turn to the innermost part."""
        now = time.perf_counter()
        self._now[self._inside[-1] if self._inside else "rest"] += now - self._since
        self._since = now

    def watch(self, owner: object, name: str, part: str) -> None:
        """Wrap a function with this clock, in its place."""
        function = getattr(owner, name)

        def timed(*args, **kwargs):
            self.turn()
            begin = self._since
            self._inside.append(part)
            try:
                return function(*args, **kwargs)
            finally:
                self.turn()
                self._inside.pop()
                self.whole[part].append(self._since - begin)

        setattr(owner, name, timed)

    def watch_steps(self) -> None:
        """Begin a new step with each call of `Simulation.advance`."""
        advance = Simulation.advance

        def timed(sim):
            self.turn()
            self.steps.append(self._now)
            self._now = Counter()
            return advance(sim)

        Simulation.advance = timed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--job", type=Path, help="another job than that of `rvm bench`")
    parser.add_argument("--cells", type=int, nargs="+", default=[64, 64])
    parser.add_argument("--velocity", type=int, nargs="+", default=[24, 24, 8])
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--skip", type=int, default=3, help="steps left out at the beginning; 400 are past the noise")
    options = parser.parse_args()
    clock = Clock()
    for part, functions in PARTS.items():
        for owner, name in functions:
            clock.watch(owner, name, part)
    clock.watch_steps()
    job = Job.from_file(options.job) if options.job else _job(tuple(options.cells), tuple(options.velocity))
    end = options.steps * first_step.first_step(job).dt
    settings = job.model_dump(exclude_none=True)
    settings["time"]["max_steps"] = options.skip + options.steps
    settings["output"]["checkpoint_every"] = "10 min"
    settings["output"]["times"] = [end * k / 10 for k in range(6)]
    comm = MPI.COMM_WORLD
    directory = comm.bcast(tempfile.mkdtemp() if comm.rank == 0 else None)
    run_job(Job.from_dict(settings, name=job.name), Path(directory) / "run", quiet=True)
    report(clock, comm, options.skip)


def report(clock: Clock, comm: MPI.Comm, skip: int) -> None:
    """Print the table on rank 0, of the steps from number `skip` on."""
    ordinary = [step for step in clock.steps[skip:] if not (step["snapshot"] or step["checkpoint"])]
    total = statistics.median(sum(step.values()) for step in ordinary)
    medians = {part: statistics.median(step[part] for step in ordinary) for part in [*PARTS, "rest"]}
    apart = {part: statistics.median(clock.whole[part][1:] or clock.whole[part]) for part in ("snapshot", "checkpoint")}
    everything = comm.gather((total, medians, apart))
    if comm.rank > 0:
        return
    total, medians, apart = (
        statistics.mean(one[0] for one in everything),
        *({part: statistics.mean(one[k][part] for one in everything) for part in everything[0][k]} for k in (1, 2)),
    )
    print(f"| part | ms | % of a step |\n| --- | --- | --- |\n| step | {1e3 * total:.2f} | 100 |")
    for part, seconds in medians.items():
        if part not in apart:
            print(f"| {part} | {1e3 * seconds:.3f} | {100 * seconds / total:.1f} |")
    others = total - medians["sweep"]
    print(f"| all but the sweep | {1e3 * others:.2f} | {100 * others / total:.1f} |")
    snapshot, checkpoint = apart["snapshot"], apart["checkpoint"]
    print(f"| a snapshot every 50 steps | {1e3 * snapshot:.1f} each | {100 * snapshot / (50 * total):.2f} |")
    print(f"| a checkpoint | {1e3 * checkpoint:.1f} | {checkpoint / total:.1f} steps |")


if __name__ == "__main__":
    main()
