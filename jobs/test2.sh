#!/bin/bash
# Test 2 of Filbet and Rey (2013), waves in a cooling gas: runs, the table of damping rates, figures in runs/test2_*/figures.
set -euo pipefail
cd "$(dirname "$0")/.."

# four times the paper's velocities, twice its cells: what the damping rates need
fine() { # NAME JOB E END
    jobs/run.sh "$1" "$2" --set 'space.cells=[50]' --set 'velocity.points=[256]' --set "collision.restitution=$3" \
        --set "time.end=$4" --set "output.times=[0, $4]"
}

jobs/run.sh test2_macroscopic test2_macroscopic
jobs/run.sh test2_classical test2_classical || [ $? = 3 ] # may lose the gas before its end
jobs/run.sh test2_specular test2_specular
fine test2_specular_e080 test2_specular 0.80 250
fine test2_specular_e085 test2_specular 0.85 50
fine test2_specular_e090 test2_specular 0.90 20
fine test2_specular_e095 test2_specular 0.95 8
fine test2_periodic_e080 test2_periodic 0.80 30

.venv/bin/python postprocess/waves.py runs/test2_macroscopic runs/test2_specular runs/test2_classical
.venv/bin/python postprocess/waves.py runs/test2_specular_e{080,085,090,095} runs/test2_periodic_e080
