"""Strong and weak scaling: the parts of a step measured, a model made of them, and how far it is off.

    mpirun -n N .venv/bin/python benchmarks/scaling.py measure FILE --cells 64 64 --velocity 24 24 8
    .venv/bin/python benchmarks/scaling.py model FILE [--figure docs/figures/scaling]

`measure` runs the loop of `rvm run` and adds a line of JSON to FILE: seconds of a step and of its parts, what was sent
and reduced, and the seconds of the same messages and reductions one after the other without any work between them.
`--split PX PY` forces a decomposition, `--as-launched` leaves the ranks of a node in a row, `--network NAME` says what
lies between the ranks (benchmarks/namespaces.py makes a slow one). Lines of one case are merged by the least of every
figure, so that other work on the machine spoils none if a case is measured often enough. `model` fits speeds and
latencies to the lines of one and two ranks, sets what they make of every line beside what was measured, and goes on to
a cluster. docs/scaling.md has the formulas.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

STAGES = 2
SHARED = "shared memory"
REPEATS = 15
#: doubles of a cell in a snapshot: moments, omega and the fluid's fields, three velocity directions
SNAPSHOT_DOUBLES = 23
CORES = len(os.sched_getaffinity(0))

# --- measuring


def job_of(cells: list[int], velocity: list[int], steps: int) -> dict:
    """The physics of Test 4 with the kinetic scaling."""
    return {
        "space": {"cells": cells},
        "velocity": {"points": velocity},
        "collision": {"operator": "granular-es-bgk", "knudsen": 0.01, "restitution": 0.99},
        "fluid": {"enabled": True},
        "initial": {"state": "random-density", "low": 0.2},
        "time": {"end": 1e3, "max_steps": steps},
    }


class Log:
    """Seconds by name in every step, and the calls to other ranks of the last one."""

    def __init__(self) -> None:
        self.steps: list[dict] = []
        self.calls: list[tuple] = []
        self._seconds: dict[str, float] = {}
        self._calls: list[tuple] = []
        self._outer: list[str] = []
        self._begin = time.perf_counter()

    def end_step(self) -> None:
        """Put away what was timed since the last call."""
        now = time.perf_counter()
        self.steps.append({**self._seconds, "step": now - self._begin})
        self.calls, self._seconds, self._calls, self._begin = self._calls, {}, [], now

    def timed(self, name: str, action, call=None):
        """`action`, its seconds added to `name`, and to "communication in stages" where it is that."""

        def run(*args, **more):
            if call is not None:
                self._calls.append(call(*args, **more))
            self._outer.append(name)
            begin = time.perf_counter()
            result = action(*args, **more)
            seconds = time.perf_counter() - begin
            self._outer.pop()
            for key in (name, "communication in stages" if "stages" in self._outer else name + " elsewhere"):
                self._seconds[key] = self._seconds.get(key, 0.0) + seconds
            return result

        return run


def watched_run(job: dict, log: Log):
    """The loop of `rvm run` with its parts timed; the simulation when it is done."""
    from mpi4py import MPI

    from rvm_mpi.job.job import Job
    from rvm_mpi.run.claim import Claim
    from rvm_mpi.run.control import Control
    from rvm_mpi.run.run import Run
    from rvm_mpi.simulation import Simulation

    class Watched(MPI.Intracomm):
        def Allreduce(self, mine, result, op=MPI.SUM):
            timed = log.timed("reductions", super().Allreduce, lambda mine, *_: ("reduce", mine.copy(), op))
            timed(mine, result, op)

    class Stepped(Simulation):
        def advance(self):
            if self.number:
                log.end_step()
            return super().advance()

    comm = MPI.COMM_WORLD
    sim = Stepped(Job.from_dict(job, "scaling"))
    sim.domain.exchange = log.timed("exchange", sim.domain.exchange, lambda *call: ("exchange", *call))
    for name in ("first_stage", "later_stages"):
        setattr(sim.kinetic, name, log.timed("stages", getattr(sim.kinetic, name)))
    folder = tempfile.TemporaryDirectory() if comm.rank == 0 else None
    output = Path(comm.bcast(folder.name if folder else None)) / "run"
    with Control(output) as control, Claim(output, comm) as claim, Run(sim, claim, False, False, quiet=True) as run:
        sim.domain.comm = Watched(sim.domain.comm)  # no sooner: PETSc takes nothing but mpi4py's own class
        run.go(control)
    comm.Barrier()
    if folder:
        folder.cleanup()
    return sim


def replayed(sim, calls: list[tuple], kind: str) -> float:
    """Seconds of the calls of one kind, made again without any work between them: the least of some repeats."""
    from mpi4py import MPI

    from rvm_mpi.grid.domain import Domain

    comm, least = MPI.COMM_WORLD, math.inf
    for _ in range(REPEATS):
        comm.Barrier()
        begin = time.perf_counter()
        for name, array, more in calls:
            if name == kind == "exchange":
                Domain.exchange(sim.domain, array, more)
            elif name == kind:
                comm.Allreduce(array, np.empty_like(array), op=more)
        least = min(least, comm.allreduce(time.perf_counter() - begin, op=MPI.MAX))
    return least


def sent(domain, calls: list[tuple]) -> dict[str, float]:
    """What this rank sends to others in a step: messages and bytes across x and y sides; and what it copies itself."""
    counts = dict.fromkeys(("messages", "bytes_x", "bytes_y", "bytes_own"), 0)
    for name, array, width in calls:
        if name != "exchange":
            continue
        for neighbour in domain._neighbours:
            (rows, columns), _ = domain._strips(neighbour, array.shape, width)
            size = 8 * (rows.stop - rows.start) * (columns.stop - columns.start) * array.shape[2]
            own = neighbour.rank == domain.rank
            counts["messages"] += not own
            counts["bytes_own" if own else ("bytes_y", "bytes_x")[neighbour.axis]] += size
    return counts


def measure(arguments: argparse.Namespace) -> None:
    from mpi4py import MPI

    from rvm_mpi.grid import domain as domain_module
    from rvm_mpi.grid import placement

    comm = MPI.COMM_WORLD
    if arguments.split:
        domain_module.partition = lambda *_: tuple(arguments.split)
    if arguments.as_launched:
        placement.places = lambda _split, _cells, node_of: list(range(len(node_of)))
    log = Log()
    sim = watched_run(job_of(arguments.cells, arguments.velocity, arguments.steps), log)
    least = {name: min(step.get(name, 0.0) for step in log.steps[1:]) for name in log.steps[-1]}
    mine = {
        **sent(sim.domain, log.calls),
        "step": least["step"],
        "stages": min(step["stages"] - step.get("communication in stages", 0.0) for step in log.steps[1:]),
        "rest": min(
            step["step"] - step["stages"] - step.get("exchange elsewhere", 0.0) - step.get("reductions elsewhere", 0.0)
            for step in log.steps[1:]
        ),
    }
    reduced = [call[1] for call in log.calls if call[0] == "reduce"]
    line = {name: comm.allreduce(value, op=MPI.MAX) for name, value in mine.items()} | {
        "exchange": replayed(sim, log.calls, "exchange"),
        "reductions": replayed(sim, log.calls, "reduce"),
        "reduced": len(reduced),
        "bytes_reduced": sum(array.nbytes for array in reduced),
        "network": arguments.network,
        "cells": arguments.cells,
        "velocity": arguments.velocity,
        "ranks": comm.size,
        "split": [-(-n // w) for n, w in zip(sim.domain.cells, comm.bcast(sim.domain.local))],
        "local": list(comm.bcast(sim.domain.local)),
    }
    if comm.rank == 0:
        with Path(arguments.file).open("a") as file:
            file.write(json.dumps(line) + "\n")
        print(json.dumps(line))


# --- the model

#: exchanges of g, of omega and of the fluid's state in a step: how many, ghost width, doubles of a cell (None: a block)
EXCHANGES = ((2, 2, None), (2, 2, 1), (4, 3, 5))


def border_bytes(nodes: int) -> int:
    """Bytes that a step sends for each cell along one side of a rank."""
    return 8 * sum(count * width * (doubles or nodes) for count, width, doubles in EXCHANGES)


@dataclass(frozen=True)
class Parts:
    """What `fitted` finds: seconds of a step's parts."""

    node: float
    """A phase-space cell in one stage."""
    ghost: float
    """The same of a ghost cell, of which a rank has one for each cell along its lower sides."""
    rest: float
    """What is neither stage nor communication: the fluid, the history, Python."""
    rest_cell: float
    """The same, a cell of space."""
    own: float
    """A byte that a rank copies to its own ghosts."""


@dataclass(frozen=True)
class Network:
    """Seconds between ranks: a message, a byte across x and y sides, and one round of a reduction."""

    message: float
    byte_x: float
    byte_y: float
    round: float

    def exchange(self, line: dict, own: float) -> float:
        """Seconds of a step's exchanges; `own`: of a byte that stays on its rank."""
        sent = self.message * line["messages"] + self.byte_x * line["bytes_x"] + self.byte_y * line["bytes_y"]
        return sent + own * line["bytes_own"]

    def reductions(self, line: dict) -> float:
        """Seconds of a step's reductions: as many rounds each as it takes to double one rank to all."""
        return self.round * line["reduced"] * math.ceil(math.log2(line["ranks"]))


@dataclass(frozen=True)
class Cluster:
    """Nodes of so many ranks each, with one link a node: seconds and bytes a second.

    A node's ranks follow each other along x, as a DMDA numbers them; `square` puts them in a square (`placement.py`).
    """

    ranks: int
    latency: float
    bandwidth: float
    square: bool = False


def least_squares(columns: list, measured: list) -> np.ndarray:
    """Coefficients, none negative, that fit relatively best."""
    from scipy.optimize import nnls

    measured = np.array(measured)
    return nnls(np.array(columns, dtype=float).T / measured[:, None], np.ones(measured.size))[0]


def fit_parts(lines: list[dict]) -> Parts:
    """From the lines of one rank and one velocity grid: its blocks fit a cache or they do not."""
    size = [(line["local"][0], line["local"][1]) for line in lines]
    nodes = math.prod(lines[0]["velocity"])
    stage = least_squares(
        [[w * h * nodes for w, h in size], [(w + h) * nodes for w, h in size]],
        [line["stages"] / STAGES for line in lines],
    )
    rest = least_squares([[1 for _ in size], [w * h for w, h in size]], [line["rest"] for line in lines])
    own = least_squares([[line["bytes_own"] for line in lines]], [line["exchange"] for line in lines])
    return Parts(*stage, *rest, *own)


def fit_network(lines: list[dict], parts: dict[tuple, Parts]) -> Network:
    """From the lines of two ranks on one network."""
    columns = [[line[name] for line in lines] for name in ("messages", "bytes_x", "bytes_y")]
    between = [line["exchange"] - parts[tuple(line["velocity"])].own * line["bytes_own"] for line in lines]
    message, byte_x, byte_y = least_squares(columns, between)
    return Network(message, byte_x, byte_y, min(line["reductions"] / line["reduced"] for line in lines))


def work(parts: Parts, wide: int, high: int, nodes: int) -> tuple[float, float]:
    """Seconds of a step's stages and of its rest on a rank of wide x high cells."""
    stage = nodes * (parts.node * wide * high + parts.ghost * (wide + high))
    return STAGES * stage, parts.rest + parts.rest_cell * wide * high


def on_cluster(parts: Parts, near: Network, cluster: Cluster, reduced: dict, cells, velocity, ranks: int) -> dict:
    """Seconds of a step and its parts on the rank that has most, none of them overlapping."""
    from rvm_mpi.grid.domain import partition

    px, py = partition(tuple(cells), ranks)
    wide, high = -(-cells[0] // px), -(-cells[1] // py)
    nodes, size = math.prod(velocity), border_bytes(math.prod(velocity))
    across_x, across_y = px > 1, py > 1
    stages, rest = work(parts, wide, high, nodes)
    bytes_x, bytes_y = 2 * high * size, 2 * wide * size
    count = sum(count for count, _, _ in EXCHANGES)
    exchange = (near.byte_x if across_x else parts.own) * bytes_x + (near.byte_y if across_y else parts.own) * bytes_y
    exchange += 2 * count * (across_x + across_y) * near.message
    machines = -(-ranks // cluster.ranks)
    rounds, far = math.ceil(math.log2(min(ranks, cluster.ranks))), math.ceil(math.log2(machines))
    link = 0.0
    if machines > 1:
        along = min(math.isqrt(cluster.ranks) if cluster.square else cluster.ranks, px)
        up = max(1, cluster.ranks // along)
        leaving = along * bytes_y + (up * bytes_x if along < px else 0)
        link = leaving / cluster.bandwidth + count * cluster.latency
    reductions = reduced["reduced"] * (rounds * near.round + far * cluster.latency)
    reductions += far * reduced["bytes_reduced"] / cluster.bandwidth
    parts_of = {"stages": stages, "rest": rest, "exchange": exchange, "link": link, "reductions": reductions}
    return {"ranks": ranks, "local": (wide, high), "step": sum(parts_of.values()), **parts_of}


def possible(cells, most: float) -> list[int]:
    """Numbers of ranks, about four a decade, that can share the cells."""
    from rvm_mpi.grid.domain import largest_ranks, partition
    from rvm_mpi.job.job import JobError

    found = {1}
    for wanted in np.geomspace(1, min(most, largest_ranks(tuple(cells))), 24):
        for ranks in range(round(wanted), max(0, int(0.8 * wanted)), -1):
            try:
                px, py = partition(tuple(cells), ranks)
            except JobError:
                continue
            if cells[0] % px == 0 and cells[1] % py == 0 or ranks <= 4:
                found.add(ranks)
                break
    return sorted(found)


# --- what is printed and drawn

FIGURE_TITLE = "Model, not measurement: the parts of a step are measured on one and two ranks, the rest is foretold"
GRIDS = (([64, 64], [24, 24, 8]), ([512, 512], [32, 32, 32]))
WEAK = ([4, 4], [8, 8], [16, 16])


def merged(path: str) -> list[dict]:
    """The lines of a file; several of one case are made one by the least of every figure."""
    cases: dict[str, dict] = {}
    for text in Path(path).read_text().splitlines():
        line = json.loads(text)
        key = str([line[name] for name in ("network", "ranks", "cells", "velocity", "split")])
        before = cases.get(key, line)
        cases[key] = {k: min(v, before[k]) if isinstance(v, float) else v for k, v in line.items()}
    return list(cases.values())


def compare(lines: list[dict], fitted: dict[tuple, Parts], networks: dict[str, Network]) -> None:
    """What the model makes of every line, beside what was measured."""
    names = "network, ranks, split, cells a rank, velocities, step ms, model, exchange ms, model, reductions us, model"
    head(names.split(", "))
    for line in lines:
        network, parts = networks[line["network"]] if line["ranks"] > 1 else None, fitted[tuple(line["velocity"])]
        wide, high = line["local"]
        exchange = network.exchange(line, parts.own) if network else parts.own * line["bytes_own"]
        reductions = network.reductions(line) if network else 0.0
        crowded = max(1.0, line["ranks"] / CORES)  # ranks that share a core work one after the other
        step = crowded * sum(work(parts, wide, high, math.prod(line["velocity"]))) + exchange + reductions
        figures = [
            f"{1e3 * line['step']:.2f}",
            f"{step / line['step'] - 1:+.0%}",
            f"{1e3 * line['exchange']:.3f}",
            f"{exchange / line['exchange'] - 1:+.0%}",
            f"{1e6 * line['reductions']:.0f}" if network else "",
            f"{reductions / line['reductions'] - 1:+.0%}" if network else "",
        ]
        shape = [" x ".join(map(str, line[name])) for name in ("split", "local", "velocity")]
        row([line["network"], str(line["ranks"]), *shape, *figures])


def row(cells: list[str]) -> None:
    print("| " + " | ".join(cells) + " |")


def head(names: list[str]) -> None:
    row(names)
    row(["---"] * len(names))


def table(rows: list[dict], title: str) -> None:
    """Predictions for one grid; efficiency against the first row, for `share` times its work."""
    parts = ("stages", "rest", "exchange", "link", "reductions")
    print(f"\n{title}\n")
    head(["ranks", "cells a rank", "step ms", "efficiency", *parts, "efficiency, square nodes"])
    for found in rows:
        ideal = rows[0]["step"] * found.get("share", 1) / found["ranks"]
        row(
            [
                str(found["ranks"]),
                " x ".join(map(str, found["local"])),
                f"{1e3 * found['step']:.4g}",
                f"{ideal / found['step']:.0%}",
                *(f"{found[name] / found['step']:.1%}" for name in parts),
                f"{ideal / found['square']:.0%}",
            ]
        )


def model(arguments: argparse.Namespace) -> None:
    lines = merged(arguments.file)
    for line in lines:
        sides = line["bytes_x"] + line["bytes_y"] + line["bytes_own"]
        assert sides == border_bytes(math.prod(line["velocity"])) * 2 * sum(line["local"]), line
    grids = {tuple(line["velocity"]) for line in lines if line["ranks"] == 1}
    parts = {
        grid: fit_parts([line for line in lines if line["ranks"] == 1 and tuple(line["velocity"]) == grid])
        for grid in grids
    }
    networks = {
        name: fit_network([line for line in lines if line["ranks"] == 2 and line["network"] == name], parts)
        for name in {line["network"] for line in lines}
    }
    print(*parts.items(), *networks.items(), "", sep="\n")
    compare(lines, parts, networks)
    reduced = next(line for line in lines if line["ranks"] == 2)

    def predict(cells, velocity, ranks, square=False):
        cluster = Cluster(arguments.ranks, arguments.latency, arguments.bandwidth, square)
        return on_cluster(parts[tuple(velocity)], networks[SHARED], cluster, reduced, cells, velocity, ranks)

    def both(cells, velocity, ranks):
        return predict(cells, velocity, ranks) | {"square": predict(cells, velocity, ranks, square=True)["step"]}

    strong = [[both(*grid, ranks) for ranks in possible(grid[0], 1e5)] for grid in GRIDS]
    for grid, rows in zip(GRIDS, strong):
        table(rows, "Strong scaling, " + " cells of ".join(" x ".join(map(str, part)) for part in grid) + " velocities")
    weak = []
    for local in WEAK:
        sides = [1, 2, 3, 8, 32, 100, 316]
        weak.append([both([k * n for n in local], GRIDS[0][1], k * k) | {"share": k * k} for k in sides])
        table(weak[-1], f"Weak scaling, {local[0]} x {local[1]} cells of 24 x 24 x 8 velocities a rank")
    output(arguments.disk)
    if arguments.figure:
        draw(strong, weak, arguments.figure)


def output(disk: float) -> None:
    """Seconds of a snapshot and of a checkpoint at the file system's speed."""
    print()
    head(["grid", "snapshot", "s", "checkpoint", "s"])
    for cells, velocity in GRIDS:
        snapshot = 8 * math.prod(cells) * SNAPSHOT_DOUBLES
        checkpoint = 8 * math.prod(cells) * math.prod(velocity)
        shape = " x ".join(map(str, cells + velocity))
        sizes = [f"{snapshot / 1e6:.3g} MB", f"{snapshot / disk:.2g}", f"{checkpoint / 1e9:.3g} GB"]
        row([shape, *sizes, f"{checkpoint / disk:.2g}"])


def draw(strong: list, weak: list, name: str) -> None:
    import matplotlib

    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
    for (cells, velocity), rows in zip(GRIDS, strong):
        label = " x ".join(map(str, cells)) + " cells, " + " x ".join(map(str, velocity))
        ranks = np.array([found["ranks"] for found in rows])
        seconds = np.array([found["step"] for found in rows])
        (line,) = left.loglog(ranks, seconds, "o-", ms=3, label=label)
        left.loglog(ranks, seconds[0] / ranks, ":", color=line.get_color(), lw=1)
        middle.semilogx(ranks, seconds[0] / ranks / seconds, "o-", ms=3, label=label)
        square = np.array([found["square"] for found in rows])
        middle.semilogx(ranks, seconds[0] / ranks / square, "--", color=line.get_color(), lw=1)
    for local, rows in zip(WEAK, weak):
        ranks, label = [found["ranks"] for found in rows], f"{local[0]} x {local[1]} cells a rank"
        right.semilogx(ranks, [1e3 * found["step"] for found in rows], "o-", ms=3, label=label)
    left.set(xlabel="ranks", ylabel="seconds of a step", title="strong scaling (dotted: ideal)")
    middle.set(xlabel="ranks", ylabel="parallel efficiency", ylim=(0, 1.05), title="dashed: a node's ranks in a square")
    right.set(xlabel="ranks", ylabel="milliseconds of a step", title="weak scaling, 24 x 24 x 8", yscale="log")
    for axes in (left, middle, right):
        axes.legend(fontsize=8)
        axes.grid(alpha=0.3)
    figure.suptitle(FIGURE_TITLE)
    figure.savefig(f"{name}.png", dpi=110)
    print(f"{name}.png")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    modes = parser.add_subparsers(dest="mode", required=True)
    first = modes.add_parser("measure")
    first.add_argument("file")
    first.add_argument("--cells", type=int, nargs="+", default=[64, 64])
    first.add_argument("--velocity", type=int, nargs="+", default=[24, 24, 8])
    first.add_argument("--split", type=int, nargs=2)
    first.add_argument("--as-launched", action="store_true", help="ranks along x first, as they are numbered")
    first.add_argument("--steps", type=int, default=12)
    first.add_argument("--network", default=SHARED)
    first.set_defaults(action=measure)
    second = modes.add_parser("model")
    second.add_argument("file")
    second.add_argument("--figure")
    second.add_argument("--ranks", type=int, default=64, help="of a node")
    second.add_argument("--latency", type=float, default=1.5e-6, help="between nodes, seconds")
    second.add_argument("--bandwidth", type=float, default=12.5e9, help="of a node's link, bytes a second")
    second.add_argument("--disk", type=float, default=10e9, help="of the file system, bytes a second")
    second.set_defaults(action=model)
    arguments = parser.parse_args()
    arguments.action(arguments)


if __name__ == "__main__":
    main()
