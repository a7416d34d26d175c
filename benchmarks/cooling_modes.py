"""Can a box cluster? Navier-Stokes about the cooling gas: `python benchmarks/cooling_modes.py [JOB...]` (a second).

For each job (by default those of Test 4 and the demo) at its mean density: mean free paths in the box; the box over
the lengths above which waves of shear and of density grow beside the cooling; the clock s = ln sqrt(T(0)/T) at the
end; and by how many powers of e a wave as long as the box has grown by then, shear (beside sqrt(T)) and density.
"""

import sys
from math import log, pi, sqrt
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from rvm_mpi import Job, kinetic_theory
from rvm_mpi.advice.stability import CoolingGas
from tests.verification.kinetic_cases import table

FOLDER = Path(__file__).resolve().parent.parent / "jobs"
JOBS = ("test4_clustering_kinetic", "test4_clustering_e075_kinetic", "demo")


def box_row(job: Job, density: float) -> tuple[float, ...]:
    """Mean free paths in the box, box over both critical lengths, s at the end, e-foldings of shear and density.

    The mean free path is eps/(sqrt(2) pi rho), that of hard spheres of unit diameter.
    """
    gas = CoolingGas.create(job.collision, job.velocity.dimensions, density, 1.0)
    length, k = min(job.space.length), np.array([2 * pi / min(job.space.length)])
    s = -0.5 * log(kinetic_theory.cooled(job.collision, density, 1.0, job.time.end))
    free_paths = length * sqrt(2) * pi * density / job.collision.knudsen
    folds = (2 * s / gas.cooling * float(growth(k)[0]) for growth in (gas.shear_growth, gas.heat_growth))
    return free_paths, length / gas.shear_wavelength, length / gas.heat_wavelength, s, *folds


def main() -> None:
    paths = [Path(name) for name in sys.argv[1:]] or [FOLDER / f"{name}.toml" for name in JOBS]
    jobs = [Job.from_file(path) for path in paths]
    rows = [(job.name, *box_row(job, 0.5 * (job.initial.low + job.initial.high))) for job in jobs]
    table("job free_paths box/shear box/density s e-foldings_shear e-foldings_density", rows)


if __name__ == "__main__":
    main()
