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

for name in macroscopic kinetic; do
    run "test3_$name" "test3_$name"
    run "test3_${name}_150" "test3_$name" --set 'space.cells=[150]'
done
run test3_kinetic_fine test3_kinetic --set 'space.cells=[200]' --set 'velocity.points=[128]'
run test3_classical test3_classical

.venv/bin/python postprocess/profiles.py --normalised --times 0.25 0.75 2 -- runs/test3_{kinetic,macroscopic,classical}
