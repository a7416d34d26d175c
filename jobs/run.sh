#!/bin/bash
# One run on this machine, for the scripts beside this one: jobs/JOB.toml into runs/OUTPUT on 2 ranks, or $RANKS.
#
#   jobs/run.sh OUTPUT JOB [OPTIONS of rvm run]
set -euo pipefail
cd "$(dirname "$0")/.."

exec jobs/mpirun.sh -n "${RANKS:-2}" --oversubscribe --bind-to none .venv/bin/rvm run "jobs/$2.toml" --output "runs/$1" "${@:3}"
