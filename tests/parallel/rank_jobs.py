"""Runs the jobs named on the command line, each into DIR/<name>; started under mpirun by `test_ranks.py`."""

import sys
from pathlib import Path

import tomli_w

from rvm_mpi.commands.main import main

GRANULAR = {"operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.8}
RANDOM = {"state": "random-density", "seed": 3, "low": 0.1}
FLUID = {"enabled": True}

JOBS = {
    "periodic": {
        "fluid": FLUID,
        "space": {"cells": [14, 13]},
        "velocity": {"points": [8, 8, 8]},
        "collision": GRANULAR,
        "initial": RANDOM,
        "time": {"end": 0.012},
        "output": {"times": [0.0, 0.004, 0.012], "marginals": True},
    },
    "walls": {
        "fluid": FLUID,
        "space": {
            "cells": [13, 12],
            "boundary": {
                "x": {
                    "lower": {"kind": "maxwell", "accommodation": 0.5, "velocity": [0.0, 0.4, 0.1]},
                    "upper": {"kind": "diffuse", "temperature": 1.3},
                },
                "y": {"lower": "specular", "upper": "far-field"},
            },
        },
        "velocity": {"points": [8, 8, 8]},
        "collision": GRANULAR,
        "initial": RANDOM,
        "time": {"end": 0.012},
        "output": {"times": [0.005, 0.012]},
    },
    "thermal": {
        "space": {
            "cells": [12, 14],
            "boundary": {
                "x": {
                    "lower": {"kind": "maxwell", "accommodation": 0.5, "velocity": [0.0, 0.4, 0.1]},
                    "upper": {"kind": "far-field", "density": 0.5, "velocity": [-3.0, 0.0, 0.0], "temperature": 0.2},
                },
                "y": {"lower": "specular", "upper": {"kind": "diffuse", "temperature": 1.3}},
            },
        },
        "velocity": {"points": [8, 8, 8], "half_width": 5.0},
        "scaling": {"kind": "thermal"},
        "collision": GRANULAR,
        "initial": RANDOM,
        "time": {"end": 0.02},
        "output": {"times": [0.01, 0.02]},
    },
    "paper": {
        "space": {"cells": [12, 14]},
        "velocity": {"points": [8, 8, 8]},
        "scaling": {"kind": "macroscopic"},
        "scheme": {"conservative": False},
        "collision": GRANULAR,
        "initial": RANDOM,
        "time": {"end": 0.012},
    },
    "slab": {
        "fluid": FLUID,
        "space": {"cells": [23], "boundary": {"x": {"lower": "outflow", "upper": "vacuum"}}},
        "velocity": {"points": [24]},
        "collision": {"operator": "es-bgk", "knudsen": 0.1, "relaxation": {"coefficient": 1.0}},
        "initial": {"state": "temperature-disc", "inner": 1.0, "outer": 4.0, "radius": 0.2},
        "time": {"end": 0.03},
        "output": {"times": [0.0, 0.03], "marginals": True},
    },
    "boltzmann": {
        "space": {"cells": [14], "boundary": {"x": {"lower": "specular", "upper": "diffuse"}}},
        "velocity": {"points": [32, 16], "half_width": 8.0},
        "collision": {"operator": "boltzmann", "knudsen": 0.2, "restitution": 0.9, "coarse": True},
        "initial": {"state": "wave", "density_amplitude": 0.2, "mode": [0.5]},
        "time": {"end": 0.02},
    },
    "front": {
        "fluid": FLUID,
        "space": {"cells": [12, 13], "lower": [-1.0, -1.0], "boundary": {"x": "far-field", "y": "far-field"}},
        "velocity": {"points": [8, 8, 8]},
        "collision": {"operator": "es-bgk", "knudsen": 0.05},
        "initial": {"state": "temperature-disc", "inner": 1.0, "outer": 100.0, "radius": 0.5},
        "time": {"end": 0.005},
    },
    "drift": {
        "space": {"cells": [12], "boundary": {"x": "specular"}},
        "velocity": {"points": [8, 8, 8]},
        "scheme": {"drift": "seventh-order-positive"},
        "collision": GRANULAR,
        "initial": {"state": "wave", "density_amplitude": 0.3, "temperature_amplitude": 0.2, "mode": [0.5]},
        "time": {"end": 0.03},
    },
}


def run(directory: Path, names: list[str]) -> int:
    """Every rank reads the files that the test wrote."""
    worst = 0
    for name in names:
        job = directory / f"{name}.toml"
        worst = max(worst, main(["run", str(job), "--output", str(directory / name), "--quiet"]))
    return worst


def write(directory: Path) -> None:
    for name, job in JOBS.items():
        (directory / f"{name}.toml").write_text(tomli_w.dumps(job))


if __name__ == "__main__":
    sys.exit(run(Path(sys.argv[1]), sys.argv[2:]))
