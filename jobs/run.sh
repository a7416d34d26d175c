#!/bin/bash
# One run on this machine, for the scripts beside this one: jobs/JOB.toml into runs/OUTPUT on 2 ranks, or $RANKS.
#
#   jobs/run.sh OUTPUT JOB [OPTIONS of rvm run]
set -euo pipefail
cd "$(dirname "$0")/.."

if [ "$(id -u)" = 0 ]; then # Open MPI refuses root unless told
    export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
fi
mpirun=$(command -v mpirun.openmpi || command -v mpirun) # the one the system's Python is built with, if it is there
exec "$mpirun" -n "${RANKS:-2}" --bind-to none .venv/bin/rvm run "jobs/$2.toml" --output "runs/$1" "${@:3}"
