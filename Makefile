# make alone lists the targets.
.DEFAULT_GOAL := help
SHELL := /bin/bash
.PHONY: help install test-tools demo test long-tests fault-tests numba-versions lint clean

PYTHON := .venv/bin/python
RANKS := 2
LAUNCH := jobs/mpirun.sh -n $(RANKS) --oversubscribe --bind-to none --mca btl ^tcp

DEMO_SHOWS := the random density is nearly even by t = 5 and gathers in clusters until t = 100 (contours_density.png), \
	whose flow keeps the energy 6 % above Haff's law while the gas cools by 5.5 decades (history_cooling.png).

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-14s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

install:  ## install what is missing (system packages, then .venv); says what before it does
	@scripts/install.sh

demo: install  ## clusters in a cooling granular gas: a short run on 2 ranks and its pictures, in runs/demo
	$(LAUNCH) .venv/bin/rvm run jobs/demo.toml --output runs/demo --overwrite
	$(PYTHON) postprocess/contours.py runs/demo
	$(PYTHON) postprocess/history.py runs/demo
	@echo "The pictures are in runs/demo/figures. What to see: $(DEMO_SHOWS)"

test-tools:
	@scripts/install.sh test

test: test-tools  ## the test suite, except what takes minutes; 1, 2 and 4 ranks where ranks matter
	$(PYTHON) -m pytest -m "not long"

long-tests: test-tools  ## the tests that take minutes or more
	$(PYTHON) -m pytest -m long

fault-tests: test-tools  ## kills, full disks, signals, damaged files: the long fault suite with its figures
	$(PYTHON) -m pytest tests/faults

numba-versions: test-tools  ## the kernels on the oldest and newest numba allowed: their tests, and the same bits
	@scripts/numba_versions.sh

lint: test-tools  ## ruff and mypy
	$(PYTHON) -m ruff check .
	$(PYTHON) -m mypy

clean:  ## remove caches and build leftovers; keeps runs/ and .venv
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .install.log *.egg-info
	find . -name __pycache__ -not -path './.venv/*' -not -path './runs/*' -prune -exec rm -rf {} +
