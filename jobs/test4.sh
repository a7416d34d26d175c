#!/bin/bash
# Test 4 of Filbet and Rey (2013), clustering in a granular gas, on this machine: runs and plots.
#
#   jobs/test4.sh              test4_clustering test4_clustering_kinetic
#   jobs/test4.sh NAME...      these jobs of jobs/
#   RANKS=4 jobs/test4.sh      on 4 ranks instead of 2
set -euo pipefail
cd "$(dirname "$0")/.."

[ $# -gt 0 ] || set -- test4_clustering test4_clustering_kinetic
if [ "$(id -u)" = 0 ]; then # Open MPI refuses root unless told
    export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
fi
for name in "$@"; do
    mpirun -n "${RANKS:-2}" .venv/bin/rvm run "jobs/$name.toml" --output "runs/$name"
    .venv/bin/python postprocess/contours.py "runs/$name"
done
