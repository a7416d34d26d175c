"""Prints a line for each group of kernels: a hash of what they leave of fixed inputs.

`scripts/numba_versions.sh` compares what two numba versions print. It needs neither PETSc nor FFTW nor more than one
process: steps are taken on a stand-in for the domain, and the Boltzmann operator's sum is given spectra and weights,
for those come from libraries whose last bit is their own.
"""

import hashlib
import sys
from pathlib import Path
from types import SimpleNamespace

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from rvm_mpi import Job
from rvm_mpi.collisions import boltzmann
from rvm_mpi.collisions.weights import Rows, block_kind
from rvm_mpi.fluid import FluidSystem
from rvm_mpi.grid.domain import aligned
from rvm_mpi.kinetic import drift
from rvm_mpi.step.stepper import KineticStepper
from tests.unit.serial_domain import SerialDomain, make_job

WALL = {"kind": "maxwell", "accommodation": 0.5, "temperature": 1.5}
FAR = {"kind": "far-field", "density": 1.0, "velocity": [0.3, 0.0], "temperature": 0.8}
GRANULAR = {"operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.9}
JOBS = {
    "between walls": {
        "space": {"cells": [6, 5], "boundary": {"x": {"lower": WALL, "upper": "specular"}, "y": "vacuum"}},
        "velocity": {"points": [8, 9, 10]},
        "scaling": {"kind": "kinetic"},
    },
    "open": {
        "space": {"cells": [5, 6], "boundary": {"x": {"lower": FAR, "upper": "outflow"}}},
        "velocity": {"points": [12, 10]},
        "scaling": {"kind": "none"},
    },
}
JOBS |= {
    name: {
        "space": {"cells": [6, 4]},
        "velocity": {"points": [12, 10]},
        "scaling": {"kind": "kinetic"},
        "scheme": {"drift": name},
    }
    for name in drift.RECONSTRUCTIONS
}
FAST = 3.0  # of the step's length over its limit, for the drift in substeps


class Alone(SerialDomain):
    """What a stepper asks of a domain beside."""

    comm = SimpleNamespace(size=1, rank=0)

    def ghosts(self, width):
        return (width if self.dimensions == 2 else 0), (width if self.dimensions >= 1 else 0)

    def empty(self, width, components, guard=0):
        wy, wx = self.ghosts(width)
        return aligned((self.local[1] + 2 * wy, self.local[0] + 2 * wx, components), guard)

    def total(self, *values):
        return values


def stepped(tables):
    """Two steps from a random state, one of them with substeps of the drift."""
    job = Job.from_dict({"initial": {"state": "uniform"}, "collision": GRANULAR, "time": {"end": 1.0}, **tables})
    domain, rng = Alone(job), np.random.default_rng(5)
    (nx, ny), d = domain.local, job.velocity.dimensions
    tensor = np.zeros((ny, nx, d, d))
    tensor[..., range(d), range(d)] = rng.uniform(0.9, 1.4, (ny, nx, d))
    stepper = KineticStepper(job, domain, rng.uniform(0.5, 1.5, (ny, nx)), 0.2 * rng.random((ny, nx, d)), tensor)
    stepper.first_stage(0.0)
    for times in (1.0, FAST):
        dt = times * 0.4 / stepper.rate
        stepper.first_stage(dt)
        stepper.later_stages(dt)
    return stepper.state()[0], *stepper.now, stepper.report


def double_sum(points=(8, 7, 10)):
    """The Boltzmann operator's sum on random spectra with random weights."""
    rows, rng = Rows.create(points), np.random.default_rng(6)
    mirror, same = block_kind(rows.keys)
    sums = boltzmann.DoubleSum(rows.pairs, 2 * mirror + same, rows.offsets, rng.random(int(rows.offsets[-1])))
    length = int(np.prod([2 * m + 1 for m in rows.modes])) * 8
    modes = [boltzmann.Modes(np.zeros(length), np.zeros(length)) for _ in range(2)]
    spectra = rng.random(2 * points[0] * points[1] * (points[2] // 2 + 1) * 16)
    boltzmann.sum_groups(spectra, 2, points, tuple(rows.modes), 0.7, sums, *modes)
    return (spectra,)


def flowed(sides):
    """Some steps of the fluid."""
    job, rng = make_job((9, 8), (0.0, 0.0), (1.0, 1.0), sides, cooling=1.3), np.random.default_rng(7)
    fluid = FluidSystem(job, SerialDomain(job))
    fluid.set_state(rng.random((8, 9)) + 0.5, 0.3 * rng.random((8, 9, 3)), rng.random((8, 9)) + 0.5)
    for _ in range(3):
        fluid.advance(0.4 / fluid.max_rate())
    return fluid.moments()


def main():
    cases = {name: lambda tables=tables: stepped(tables) for name, tables in JOBS.items()}
    cases["double sum"] = double_sum
    cases |= {f"fluid, {side}": lambda side=side: flowed(side) for side in ("periodic", "specular")}
    for name, case in cases.items():
        digest = hashlib.sha256()
        for array in case():
            assert array.dtype.kind != "f" or np.isfinite(array).all()
            digest.update(np.ascontiguousarray(array).tobytes())
        print(f"{name}: {digest.hexdigest()[:32]}", flush=True)
    print(f"numba {numba.__version__}, NumPy {np.__version__}", file=sys.stderr)


if __name__ == "__main__":
    main()
