#!/bin/bash
# The kernels on the oldest and on the newest numba that pyproject.toml allows: their own tests, and the same bits.
#
#   scripts/numba_versions.sh          the tests of the kernels on both, then what they compute
#   scripts/numba_versions.sh bits     what they compute alone
#
# Each version is put into an environment of its own that goes afterwards. Where there is no oldest for this Python (its
# wheels are for older ones), the numba that `make test` runs on stands for it. Does nothing where pip reaches no index.
set -euo pipefail
cd "$(dirname "$0")/.."
what=${1:-tests}
here=.venv/bin/python
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
tests=(tests/unit/test_simd.py tests/unit/test_kernels_{transport,conservation,drift,gaussian,walls,moments}.py)
needs=(scipy hypothesis pytest pytest-timeout pydantic tomli_w tqdm tomli pyfftw mpi4py)
unset PYTHONPATH

bounds=$($here - <<'END'
import re
text = open("pyproject.toml", encoding="utf-8").read()
print(re.search(r'"numba>=([^,"]*),', text)[1], re.search(r'"(numba[^"]*)"', text)[1])
END
)
oldest=${bounds% *} range=${bounds#* }

pip() { "$place/$1/bin/pip" --disable-pip-version-check --quiet "${@:2}"; }
compute() { NUMBA_CACHE_DIR=$place/cache PYTHONPATH=$PWD "$1" tests/unit/kernel_bits.py >"$2"; }
run_tests() { NUMBA_CACHE_DIR=$place/cache PYTHONPATH=$PWD "$1" -m pytest -q -p no:cacheprovider "${tests[@]}"; }

$here -m venv "$place/newest"
if ! pip newest download --no-deps --only-binary :all: --dest "$place" "$range" 2>"$place/log"; then
    echo "numba_versions: skipped, pip finds no $range: $(tail -n 1 "$place/log")"
    exit 0
fi
pip newest install --only-binary numba,llvmlite "$range" "${needs[@]}"
pythons=("$place/newest/bin/python")
$here -m venv "$place/oldest"
if pip oldest install --only-binary numba,llvmlite "numba==$oldest" "${needs[@]}" 2>"$place/log"; then
    pythons=("$place/oldest/bin/python" "${pythons[@]}")
else
    echo "numba_versions: no numba $oldest for this Python; the one of .venv stands for it"
    pythons=("$here" "${pythons[@]}")
fi

if [ "$what" != bits ]; then
    for python in "${pythons[@]}"; do run_tests "$python"; done
fi
compute "${pythons[0]}" "$place/bits-0" &
compute "${pythons[1]}" "$place/bits-1"
wait $!
if ! diff "$place/bits-0" "$place/bits-1"; then
    echo "numba_versions: the kernels' results differ between these versions" >&2
    exit 1
fi
echo "numba_versions: the same bits on both, $(wc -l <"$place/bits-0") groups of kernels"
