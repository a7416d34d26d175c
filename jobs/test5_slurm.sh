#!/bin/bash
# Test 5 of Filbet and Rey (2013), a temperature jump of 1 to 100, under SLURM. From the project's root:
#
#   sbatch jobs/test5_slurm.sh                 test5_shock_kinetic
#   sbatch jobs/test5_slurm.sh NAME            another job of jobs/
#
# Two minutes before the time limit SLURM sends SIGUSR1 to this script (the B: below), which hands it to the ranks:
# rvm writes a checkpoint and exits with status 75, "run again with --restart". This script then puts itself back
# into the queue, and goes on from the checkpoint when its turn comes; so it does after a node has failed.
#
#SBATCH --job-name=rvm-test5
#SBATCH --nodes=1
#SBATCH --ntasks=16
#SBATCH --cpus-per-task=1
#SBATCH --time=02:00:00
#SBATCH --signal=B:USR1@120
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=%x-%j.log
set -euo pipefail
cd "${SLURM_SUBMIT_DIR:?submit this script with sbatch}"
# module load openmpi petsc hdf5        # as on your cluster: docs/install.md

exec jobs/slurm_run.sh "${1:-test5_shock_kinetic}"
