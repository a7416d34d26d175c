#!/bin/bash
# Test 3 of Filbet and Rey (2013), a granular gas between two warm walls: runs, and figures in runs/test3_*/figures.
set -euo pipefail
cd "$(dirname "$0")/.."

if [ "$(id -u)" = 0 ]; then # Open MPI refuses root unless told
    export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
fi
run() { # OUTPUT JOB [OPTIONS]
    mpirun -n "${RANKS:-2}" .venv/bin/rvm run "jobs/$2.toml" --output "runs/$1" "${@:3}"
}

run test3_macroscopic test3_macroscopic
run test3_macroscopic_150 test3_macroscopic --set 'space.cells=[150]'
run test3_classical test3_classical
# ends with exit status 3 at t = 1.76: 64 velocities do not hold the jump of g at the wall
run test3_kinetic test3_kinetic || [ $? = 3 ]

.venv/bin/python postprocess/profiles.py --normalised --times 0.25 0.75 2 -- runs/test3_{macroscopic,classical}
.venv/bin/python postprocess/profiles.py --normalised --times 0.25 0.75 -- runs/test3_{kinetic,macroscopic,classical}
