"""The tiny jobs of restart_program.py: named ones, and every operator with every scaling in every dimension."""

from rvm_mpi.job.job import Job

STEPS = 6
GRANULAR = {"operator": "granular-es-bgk", "knudsen": 0.2, "restitution": 0.9}
RANDOM = {"state": "random-density", "low": 0.5, "seed": 4}
WAVE = {"state": "wave", "density_amplitude": 0.2, "temperature_amplitude": 0.2}
FLUID = {"enabled": True}
WALL = {"kind": "maxwell", "accommodation": 0.7, "temperature": 1.2, "velocity": [0.0, 0.1]}

CASES = {
    "0d": {"space": {"cells": []}, "collision": GRANULAR, "initial": {"state": "uniform", "velocity": [0.3, 0.0]}},
    "1d-macroscopic": {
        "space": {"cells": [11], "boundary": {"x": {"lower": "specular", "upper": "far-field"}}},
        "scaling": {"kind": "macroscopic", "synchronise": 2.0},
        "scheme": {"conservative": False},
        "collision": GRANULAR,
        "initial": RANDOM,
    },
    "1d-unscaled": {
        "space": {"cells": [10], "boundary": {"x": {"lower": "vacuum", "upper": "outflow"}}},
        "scaling": {"kind": "none"},
        "collision": {"operator": "none"},
        "initial": WAVE,
    },
    "1d-boltzmann": {
        "space": {"cells": [11], "boundary": {"x": {"lower": "specular", "upper": "diffuse"}}},
        "collision": {"operator": "boltzmann", "knudsen": 0.2, "restitution": 0.95, "penalise": True, "coarse": True},
        "fluid": FLUID,
        "initial": WAVE,
    },
    "2d-walls": {
        "space": {"cells": [9, 7], "boundary": {"x": {"lower": WALL, "upper": "far-field"}, "y": "specular"}},
        "collision": GRANULAR,
        "fluid": FLUID,
        "initial": RANDOM,
        "output": {"marginals": True},
    },
    "2d-macroscopic": {
        "space": {"cells": [7, 9]},
        "scaling": {"kind": "macroscopic", "synchronise": "auto"},
        "collision": GRANULAR,
        "initial": RANDOM,
    },
    "2d-front": {
        "space": {"cells": [9, 8], "boundary": {"x": "far-field", "y": "far-field"}},
        "collision": {"operator": "es-bgk", "knudsen": 0.05},
        "initial": {"state": "temperature-disc", "inner": 1.0, "outer": 100.0, "radius": 0.25, "centre": [0.5, 0.5]},
    },
    "2d-kinetic": {
        "space": {"cells": [8, 9], "boundary": {"x": "periodic", "y": {"lower": "outflow", "upper": "diffuse"}}},
        "scheme": {"drift": "seventh-order"},
        "fluid": FLUID,
        "collision": {"operator": "es-bgk", "knudsen": 0.05},
        "initial": {**WAVE, "mode": [1, 1]},
    },
}


#: every operator ...
OPERATORS = {
    "free": {"operator": "none"},
    "es-bgk": {"operator": "es-bgk", "knudsen": 0.2},
    "granular": GRANULAR,
    "boltzmann": {"operator": "boltzmann", "knudsen": 0.2, "restitution": 0.95, "coarse": True},
    "penalised": {"operator": "boltzmann", "knudsen": 0.2, "restitution": 0.95, "penalise": True, "coarse": True},
}
#: ... with every scaling ...
SCALINGS = {
    "unscaled": {"scaling": {"kind": "none"}},
    "macroscopic": {"scaling": {"kind": "macroscopic"}, "scheme": {"conservative": False}},
    "macroscopic-conservative": {"scaling": {"kind": "macroscopic"}, "scheme": {"conservative": True}},
    "synchronised": {"scaling": {"kind": "macroscopic", "synchronise": 2.0}, "scheme": {"conservative": False}},
    "kinetic": {"scaling": {"kind": "kinetic"}, "fluid": FLUID},
    "thermal": {"scaling": {"kind": "thermal"}},
}
#: ... in every dimension
SPACES = {
    0: {"space": {"cells": []}, "initial": {"state": "uniform", "stress": [[1.2, 0.1], [0.1, 0.9]]}},
    1: {"space": {"cells": [9], "boundary": {"x": {"lower": "specular", "upper": "diffuse"}}}, "initial": WAVE},
    2: {"space": {"cells": [9, 6], "boundary": {"x": "periodic", "y": "specular"}}, "initial": RANDOM},
}
EVERYWHERE = {
    dimensions: {
        f"{dimensions}d-{operator}-{scaling}": {**space, **tables, "collision": collision}
        for operator, collision in OPERATORS.items()
        for scaling, tables in SCALINGS.items()
    }
    for dimensions, space in SPACES.items()
}


def make_job(case, steps):
    tables = CASES.get(case) or EVERYWHERE[int(case[0])][case]
    output = {"times": [0.0, 0.004, 0.02, 0.9], **tables.get("output", {})}
    changes = {"velocity": {"points": [12, 10]}, "time": {"end": 1.0, "max_steps": steps}, "output": output}
    return Job.from_dict({**tables, **changes}, name=case)
