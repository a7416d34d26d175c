#!/bin/bash
# Test 5 of Filbet and Rey (2013), a temperature jump of 1 to 100, on this machine: runs and plots.
#
#   jobs/test5.sh              test5_shock test5_hot_spot
#   jobs/test5.sh NAME...      these jobs of jobs/
#   RANKS=4 jobs/test5.sh      on 4 ranks instead of 2
set -euo pipefail
cd "$(dirname "$0")/.."

[ $# -gt 0 ] || set -- test5_shock test5_hot_spot
for name in "$@"; do
    jobs/mpirun.sh -n "${RANKS:-2}" .venv/bin/rvm run "jobs/$name.toml" --output "runs/$name"
    .venv/bin/python postprocess/contours.py "runs/$name"
done
