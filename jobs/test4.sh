#!/bin/bash
# Test 4 of Filbet and Rey (2013), clustering in a granular gas, on this machine: runs and plots.
#
#   jobs/test4.sh              test4_clustering test4_clustering_kinetic
#   jobs/test4.sh NAME...      these jobs of jobs/
#   RANKS=4 jobs/test4.sh      on 4 ranks instead of 2
set -euo pipefail
cd "$(dirname "$0")/.."

[ $# -gt 0 ] || set -- test4_clustering test4_clustering_kinetic
for name in "$@"; do
    jobs/mpirun.sh -n "${RANKS:-2}" .venv/bin/rvm run "jobs/$name.toml" --output "runs/$name"
    .venv/bin/python postprocess/contours.py "runs/$name"
done
