"""A stage of the kinetic step against the triad, by velocity grid: `python benchmarks/stages.py` (ten minutes).

Each line is what `rvm bench` measures, one core, with AVX-512 where the machine has it (`native`) and with the
instructions of an older processor that has AVX2 alone (`haswell`, compiled anew, a minute). The share of the arithmetic
peak counts the additions, multiplications and divisions of `OPERATIONS` against fused multiply-adds of the same run.
The last two columns are the stage's kernels alone and what a C compiler makes of the same (`stage_bound.py`).
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
#: cells and velocities; in each some 1 GB in two copies of g, but where a stage is long enough with less
GRIDS = {
    "24x24x8": ((64, 64), (24, 24, 8)),
    "16x16x16": ((64, 64), (16, 16, 16)),
    "24x24x24": ((48, 48), (24, 24, 24)),
    "32x32x32": ((32, 32), (32, 32, 32)),
    "24x24x9": ((64, 64), (24, 24, 9)),
    "15x15x15": ((64, 64), (15, 15, 15)),
    "32x32": ((128, 128), (32, 32)),
    "64": ((4096,), (64,)),
}
AVX2 = "+sse4.2,+popcnt,+avx,+avx2,+fma,+bmi,+bmi2,+lzcnt,+f16c,+movbe"
#: a node's share of a stage on a three-dimensional velocity grid, counted by hand in the kernels: fluxes between cells
#: and their moments 40, drift and update 41, sums over the nodes 12 (twice with the correction), the Gaussian once 11,
#: the mixture of both 5
OPERATIONS = {"corrected": 121, "uncorrected": 109}
#: what is timed beside its twin in C (stage_bound.py): the grids whose slabs are whole vectors in each half
BOUND = ("24x24x8", "16x16x16", "24x24x24", "32x32x32")
MEASURE = """
import sys, json
from rvm_mpi.commands.bench import run_bench
run_bench(*json.loads(sys.argv[1]), as_json=True)
"""


def measure(cells: tuple[int, ...], velocity: tuple[int, ...], processor: str, cache: str) -> dict[str, float]:
    """What `rvm bench --json` says, in a process of its own for that processor."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(PROJECT)}
    if processor != "native":
        # numba takes this machine's features, AVX-512 among them, whatever the name, unless told
        environment |= {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": AVX2, "NUMBA_CACHE_DIR": cache}
    done = subprocess.run(
        [sys.executable, "-c", MEASURE, json.dumps([cells, velocity])],
        env=environment,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    found: dict[str, float] = json.loads(done.stdout)
    return found


def bound(cells: tuple[int, ...], velocity: tuple[int, ...]) -> dict[str, float]:
    """What stage_bound.py says."""
    command = [sys.executable, Path(__file__).with_name("stage_bound.py"), *map(str, (*cells, *velocity))]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(PROJECT)}
    done = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grids", nargs="+", choices=GRIDS, default=list(GRIDS), metavar="GRID", help=" ".join(GRIDS))
    parser.add_argument("--processors", nargs="+", default=["native", "haswell"], help="as numba names them")
    options = parser.parse_args()
    columns = ["velocities", "processor", "triad ns"]
    for kind in ("stage", "uncorrected"):
        columns += [f"{kind} ns", "x triad", "FMA peak"]
    columns += ["its kernels ns", "the same in C ns"]
    print("| " + " | ".join(columns) + " |")
    print("| " + " | ".join(["---"] * len(columns)) + " |")
    with tempfile.TemporaryDirectory() as cache:
        for processor in options.processors:
            for name in options.grids:
                cells, velocity = GRIDS[name]
                r = measure(cells, velocity, processor, cache)
                row = [name, processor, f"{r['triad_ns']:.2f}"]
                for kind, prefix in (("corrected", "stage"), ("uncorrected", "uncorrected")):
                    ns = r[f"{prefix}_ns"]
                    share = f"{OPERATIONS[kind] / ns / r['gflops']:.0%}" if len(velocity) == 3 else ""
                    row += [f"{ns:.2f}", f"{r[f'{prefix}_per_triad']:.2f}", share]
                limit = bound(cells, velocity) if processor == "native" and name in BOUND else None
                row += [f"{limit['kernels_ns']:.2f}", f"{limit['c_ns']:.2f}"] if limit else ["", ""]
                print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
