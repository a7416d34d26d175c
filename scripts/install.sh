#!/bin/bash
# Installs what rvm_mpi needs on Debian or Ubuntu, and says what before it does.
#
#   scripts/install.sh         to run
#   scripts/install.sh test    to run, test and lint
#
# System packages come first (everything compiled against MPI or numpy), then .venv, made with the
# system's own Python so that it sees them. Does nothing, at once, where all is there.
set -euo pipefail
cd "$(dirname "$0")/.."
unset PYTHONPATH PYTHONHOME VIRTUAL_ENV

purpose=${1:-run}
root=$PWD
python=/usr/bin/python3
log=$root/.install.log
packages=(openmpi-bin python3-mpi4py python3-petsc4py python3-h5py python3-h5py-mpi python3-numpy python3-scipy
    python3-numba python3-pyfftw python3-xarray python3-matplotlib python3-venv)
extras=
if [ "$purpose" = test ]; then
    packages+=(shellcheck)
    extras="[test,dev]"
fi

say() { printf 'rvm_mpi: %s\n' "$*"; }
fail() { printf 'rvm_mpi: %s\n' "$*" >&2; exit 1; }
failed_log() { tail -n 15 "$log" >&2; fail "$* (above: the end of ${log#"$root"/})"; }

# The stamp holds everything the installation depends on; the same stamp means nothing to do.
stamp=$root/.venv/.installed-$purpose
fingerprint() {
    printf '%s\n' "$root" "$purpose" "$(readlink -f "$python")"
    sha256sum pyproject.toml scripts/install.sh scripts/venv_setup.py
}
[ -f "$stamp" ] && [ "$(fingerprint)" = "$(cat "$stamp")" ] && exit 0

command -v dpkg-query >/dev/null || fail "not Debian or Ubuntu: docs/install.md says how to install elsewhere"

# What is not there yet; numba and pyfftw, which some releases do not have, then come from pip.
in_lists() { [[ $(apt-cache policy "$1" 2>/dev/null) =~ Candidate:\ [^\(] ]]; }
look() {
    missing=()
    from_pip=()
    local package
    for package in "${packages[@]}"; do
        if [ "$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null)" = installed ]; then
            continue
        elif [[ $package =~ ^python3-(numba|pyfftw)$ ]] && ! in_lists "$package" && in_lists python3-numpy; then
            from_pip+=("${package#python3-}")
        else
            missing+=("$package")
        fi
    done
}

look
if [ ${#missing[@]} -gt 0 ]; then
    sudo=()
    if [ "$(id -u)" != 0 ]; then
        { command -v sudo >/dev/null && { sudo -n true 2>/dev/null || { [ -t 0 ] && sudo -v; }; }; } ||
            fail "missing system packages and no root or sudo here; ask for: apt-get install ${missing[*]}"
        sudo=(sudo)
    fi
    apt=("${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq)
    "${apt[@]}" update >"$log" 2>&1 || say "apt-get update failed; going on with the lists at hand"
    look
    say "installing with ${sudo:+sudo }apt-get (a minute or two): ${missing[*]}"
    "${apt[@]}" install -y --no-install-recommends "${missing[@]}" >>"$log" 2>&1 </dev/null ||
        failed_log "apt-get install failed for: ${missing[*]}"
fi

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 10))' || fail "$python is older than 3.10"
wanted="home = /usr/bin
include-system-site-packages = true"
if [ "$(grep -E '^(home|include-system)' .venv/pyvenv.cfg 2>/dev/null)" != "$wanted" ] ||
    ! .venv/bin/python -c '' 2>/dev/null; then
    say "making .venv with $python"
    "$python" -m venv --clear --system-site-packages .venv >"$log" 2>&1 || failed_log "could not make .venv"
fi
.venv/bin/python scripts/venv_setup.py prepare || fail "could not prepare .venv"
say "installing with pip into .venv: rvm_mpi$extras and its dependencies${from_pip[*]:+, ${from_pip[*]}}"
pip=(.venv/bin/python -m pip install --disable-pip-version-check --constraint .venv/constraints.txt)
"${pip[@]}" 'pip>=23' >"$log" 2>&1 || failed_log "pip could not update itself"  # older ones do not isolate builds
"${pip[@]}" --editable ".$extras" "${from_pip[@]}" >>"$log" 2>&1 || failed_log "pip install failed"
.venv/bin/python scripts/venv_setup.py check || fail "the installation does not work"
say "compiling the kernels for this processor (a minute)"
.venv/bin/rvm compile || say "the kernels could not be compiled now: the first run does it"

fingerprint >"$stamp"
say "installed: .venv/bin/rvm"
