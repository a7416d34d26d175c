#!/bin/bash
# Runs the kernels' own tests on the newest numba that pyproject.toml allows, in an environment of its own that goes
# afterwards; the system's is what `make test` runs on. Wants pip's index; takes two minutes.
set -euo pipefail
cd "$(dirname "$0")/.."
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
numba=$(python3 - <<'END'
import re
print(re.search(r'"(numba[^"]*)"', open("pyproject.toml", encoding="utf-8").read())[1])
END
)
python3 -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --upgrade "$numba" numpy scipy hypothesis pytest pydantic tomli_w pyfftw mpi4py
"$place/venv/bin/python" -c 'import numba, numpy; print("numba", numba.__version__, "NumPy", numpy.__version__)'
PYTHONPATH=$PWD NUMBA_CACHE_DIR=$place/cache "$place/venv/bin/python" -m pytest -q -p no:cacheprovider \
    tests/unit/test_simd.py tests/unit/test_kernels_{transport,conservation,drift,gaussian,walls,moments}.py
