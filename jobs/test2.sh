#!/bin/bash
# Test 2 of Filbet and Rey (2013), waves in a cooling gas: runs, the table of damping rates, figures in runs/test2_*/figures.
set -euo pipefail
cd "$(dirname "$0")/.."

if [ "$(id -u)" = 0 ]; then # Open MPI refuses root unless told
    export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
fi
run() { # OUTPUT JOB [OPTIONS]
    mpirun -n "${RANKS:-2}" .venv/bin/rvm run "jobs/$2.toml" --output "runs/$1" "${@:3}"
}
fine=(--set 'velocity.points=[256]' --set time.end=30 --set 'output.times=[0, 30]')

run test2_macroscopic test2_macroscopic
run test2_classical test2_classical
run test2_specular test2_specular
for e in 0.80 0.85 0.90 0.95; do
    run "test2_specular_e${e/./}" test2_specular "${fine[@]}" --set "collision.restitution=$e"
done
run test2_periodic_e090 test2_periodic "${fine[@]}"

.venv/bin/python postprocess/waves.py runs/test2_macroscopic runs/test2_specular runs/test2_classical
.venv/bin/python postprocess/waves.py runs/test2_specular_e{080,085,090,095}
.venv/bin/python postprocess/waves.py runs/test2_periodic_e090 runs/test2_specular_e090
