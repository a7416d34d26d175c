#!/bin/bash
# One run under SLURM, for the batch scripts beside this one, which ask for the machine: jobs/NAME.toml into runs/NAME.
# They `exec` it, so that the SIGUSR1 that SLURM sends to the batch script comes here, and from here to the ranks:
# rvm writes a checkpoint and exits with status 75, "run again with --restart". Then the job goes back into the queue.
#
#   exec jobs/slurm_run.sh NAME
set -euo pipefail

name=$1
how=(--overwrite) # what is there without a checkpoint is moved aside
if compgen -G "runs/$name/checkpoint-*.h5" >/dev/null; then
    how=(--restart)
fi

jobs/mpirun.sh -n "$SLURM_NTASKS" --bind-to core \
    .venv/bin/rvm run "jobs/$name.toml" --output "runs/$name" "${how[@]}" &
trap 'interrupted=yes; kill -USR1 "$!"' USR1
while # the signal ends the wait, not the run
    interrupted='' status=0
    wait "$!" || status=$?
    [ -n "$interrupted" ]
do :; done

if [ "$status" = 75 ]; then
    scontrol requeue "$SLURM_JOB_ID"
fi
exit "$status"
