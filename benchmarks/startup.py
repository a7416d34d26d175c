"""Seconds from the start of `rvm run` to its first finished step, without and with compiled kernels on disk.

A run is timed until step 1 stands in its history, and until the command has ended. Cold is with an empty directory for
the kernels, warm with what the cold run left there. MPI's start and the imports are in it, as a user has them.

    python benchmarks/startup.py [--job jobs/demo.toml] [--ranks 1 2] [--times 3]
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

MPIRUN = shutil.which("mpirun.openmpi") or "mpirun"


def seconds(job: Path, ranks: int, kernels: Path) -> tuple[float, float]:
    """Seconds to the first step and to the end of a run of one step, with kernels from and to a directory."""
    with tempfile.TemporaryDirectory() as directory:
        output = Path(directory) / "run"
        launcher = [MPIRUN, "-n", str(ranks), "--oversubscribe", "--bind-to", "none"] if ranks > 1 else []
        command = [*launcher, sys.executable, "-m", "rvm_mpi", "run", str(job), "--output", str(output), "--quiet"]
        begin = time.perf_counter()
        with subprocess.Popen(
            [*command, "--set", "time.max_steps=1"], env=os.environ | {"NUMBA_CACHE_DIR": str(kernels)}
        ) as run:
            history = output / "history.csv"
            while run.poll() is None and not (history.exists() and history.read_bytes().count(b"\n") >= 3):
                time.sleep(0.005)
            step = time.perf_counter() - begin
            if run.wait() != 0:
                raise SystemExit(f"{' '.join(command)} ended with status {run.returncode}")
    return step, time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--job", type=Path, default=Path("jobs/demo.toml"))
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--times", type=int, default=3)
    options = parser.parse_args()
    print("| ranks | kernels | to step 1, s | to the end, s |\n| --- | --- | --- | --- |")
    for ranks in options.ranks:
        found: dict[str, list[tuple[float, float]]] = {"cold": [], "warm": []}
        for _ in range(options.times):
            with tempfile.TemporaryDirectory() as kernels:
                for state in found.values():
                    state.append(seconds(options.job, ranks, Path(kernels)))
        for state, times in found.items():
            step, end = (min(one) for one in zip(*times, strict=True))
            print(f"| {ranks} | {state} | {step:.2f} | {end:.2f} |", flush=True)


if __name__ == "__main__":
    main()
