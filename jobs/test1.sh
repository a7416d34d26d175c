#!/bin/bash
# Test 1 of Filbet and Rey (2013), concentration to a Dirac mass: runs, and figures in runs/test1_*/figures.
set -euo pipefail
cd "$(dirname "$0")/.."

for name in coupled macroscopic; do
    .venv/bin/rvm run "jobs/test1_$name.toml" --output "runs/test1_${name}_96" --set 'velocity.points=[96, 96]'
    .venv/bin/rvm run "jobs/test1_$name.toml" --output "runs/test1_$name"
done
.venv/bin/rvm run jobs/test1_kinetic.toml --output runs/test1_kinetic
# all three with a drift that hardly errs
for name in coupled macroscopic kinetic; do
    .venv/bin/rvm run "jobs/test1_$name.toml" --output "runs/test1_${name}_seventh" --set 'scheme.drift="seventh-order"'
done
# in classical variables the gas shrinks below the spacing: this run ends with exit status 3, as it should
.venv/bin/rvm run jobs/test1_classical.toml --output runs/test1_classical || [ $? = 3 ]

.venv/bin/python postprocess/marginals.py --times 0.5 10 50 -- runs/test1_coupled runs/test1_macroscopic runs/test1_kinetic
.venv/bin/python postprocess/marginals.py --times 0.5 10 50 -- runs/test1_coupled_96 runs/test1_macroscopic_96
.venv/bin/python postprocess/marginals.py --times 0.3 1 -- runs/test1_classical runs/test1_macroscopic
.venv/bin/python postprocess/marginals.py --times 0.3 1 20 -- runs/test1_macroscopic
