#!/bin/bash
# Test 3 of Filbet and Rey (2013), a granular gas between two warm walls: runs, and figures in runs/test3_*/figures.
set -euo pipefail
cd "$(dirname "$0")/.."

jobs/run.sh test3_macroscopic test3_macroscopic
jobs/run.sh test3_classical test3_classical
jobs/run.sh test3_kinetic test3_kinetic
jobs/run.sh test3_kinetic_150 test3_kinetic --set 'space.cells=[150]'
# what they converge to: four runs that agree
jobs/run.sh test3_kinetic_fine test3_kinetic --set 'velocity.points=[128]'
jobs/run.sh test3_kinetic_150_fine test3_kinetic --set 'velocity.points=[128]' --set 'space.cells=[150]'
jobs/run.sh test3_van_leer_fine test3_kinetic --set 'velocity.points=[128]' --set 'scheme.drift="van-leer"'
jobs/run.sh test3_classical_fine test3_classical --set 'velocity.points=[128]'

.venv/bin/python postprocess/profiles.py --normalised --no-fluid --times 0.25 0.75 2 -- \
    runs/test3_{kinetic,kinetic_fine,macroscopic,classical}
