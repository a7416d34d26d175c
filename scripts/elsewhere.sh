#!/bin/bash
# Tries the README's two commands on another system than this one: a bare root by debootstrap with git and make, a
# clean clone of what is committed here, then `make demo` and `make test` there. Prints versions, counts and times; the
# status is 1 if a command failed. The logs are in runs/elsewhere.
#
#   scripts/elsewhere.sh debian12|debian13|ubuntu2204|ubuntu2404 [OPTIONS] [TARGET...]
#
#   --dir DIR        where the root is made, with 4 GB free (default: $TMPDIR or /var/tmp)
#   --keep           leave the root there
#   --mirror URL     the system's packages (default: its public archive)
#   --keyring FILE   the archive's keys (default: where debian-archive-keyring and ubuntu-keyring put them)
#   TARGET           make these instead of demo and test
#
# Wants root, debootstrap, and a machine that allows mounts. What apt and pip need here to reach their archives (a
# proxy, a certificate, an index of one's own) they are told there too.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { printf 'elsewhere: %s\n' "$*"; }
fail() { printf 'elsewhere: %s\n' "$*" >&2; exit 2; }

system=${1:-}
distribution=${system%%[0-9]*}
case $system in
    debian12) suite=bookworm ;;
    debian13) suite=trixie ;;
    ubuntu2204) suite=jammy ;;
    ubuntu2404) suite=noble ;;
    *) fail "which system? debian12, debian13, ubuntu2204 or ubuntu2404" ;;
esac
shift
if [ "$distribution" = debian ]; then
    mirror=http://deb.debian.org/debian components=main keys=debian-archive-keyring pattern=sid
else
    mirror=http://archive.ubuntu.com/ubuntu components=main,universe keys=ubuntu-keyring pattern=gutsy
fi
keyring=/usr/share/keyrings/$distribution-archive-keyring.gpg
place=${TMPDIR:-/var/tmp} keep='' targets=()
while [ $# -gt 0 ]; do
    case $1 in
        --keep) keep=yes ;;
        --dir | --mirror | --keyring)
            [ $# -gt 1 ] || fail "$1 wants a value"
            case $1 in --dir) place=$2 ;; --mirror) mirror=$2 ;; --keyring) keyring=$2 ;; esac
            shift
            ;;
        -*) fail "no such option: $1" ;;
        *) targets+=("$1") ;;
    esac
    shift
done
[ ${#targets[@]} -gt 0 ] || targets=(demo test)

[ "$(id -u)" = 0 ] || fail "only root can make another system's root"
command -v debootstrap >/dev/null || fail "debootstrap is missing: apt-get install debootstrap"
[ -r "$keyring" ] || fail "no keys of the archive: install $keys (Debian 13 has both), or give --keyring FILE"
[ -d "$place" ] || fail "no directory $place"
[ "$(df --output=avail -k "$place" | tail -n 1)" -gt 4000000 ] || fail "less than 4 GB free in $place: give --dir DIR"
unshare --mount --pid --fork true 2>/dev/null || fail "this machine does not allow unshare --mount --pid"
[ -z "$(git status --porcelain)" ] || say "what is not committed is not tried"

root=$(mktemp -d "$place/rvm_mpi-$system.XXXXXX")
# shellcheck disable=SC2317,SC2329  # called by the trap
leave() { if [ "$keep" ]; then say "kept: $root"; else rm -rf --one-file-system "$root"; fi; }
trap leave EXIT
trap 'exit 130' INT TERM HUP
logs=$PWD/runs/elsewhere
mkdir -p "$logs"

# A command in the root, with mounts and processes of its own, which end with it. The shell stays, to take in orphans.
inside() {
    # shellcheck disable=SC2016  # for the inner shell
    unshare --mount --pid --fork --kill-child bash -euc '
        root=$1
        shift
        mount -t proc proc "$root/proc"
        mount --rbind /sys "$root/sys"
        mount --rbind /dev "$root/dev"
        mount -t tmpfs -o mode=1777 tmpfs "$root/dev/shm"
        chroot "$root" env --ignore-environment "$@"
        exit' - "$root" "${environment[@]}" "$@" </dev/null
}

# What apt and pip are told here.
environment=(HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 DEBIAN_FRONTEND=noninteractive)
settings_of_apt_and_pip() {
    local name variable value
    apt-config dump 2>/dev/null | grep -E '^Acquire::(https?::(Proxy|Verify)|Check-)' \
        >"$root/etc/apt/apt.conf.d/99outside" || true
    for name in http_proxy https_proxy no_proxy HTTP_PROXY HTTPS_PROXY NO_PROXY; do
        [ -z "${!name:-}" ] || environment+=("$name=${!name}")
    done
    for name in index-url trusted-host proxy timeout cert; do
        variable=PIP_${name^^}
        variable=${variable//-/_}
        value=${!variable:-$(python3 -m pip config get "global.$name" 2>/dev/null || true)}
        [ -n "$value" ] || continue
        if [ "$name" = cert ]; then
            cp "$value" "$root/etc/outside-certificates.pem"
            value=/etc/outside-certificates.pem
        fi
        environment+=("$variable=$value")
    done
}

say "$system: a bare root in $root"
script=()
scripts=/usr/share/debootstrap/scripts
[ -e "$scripts/$suite" ] || script=("$scripts/$pattern") # the system is newer than debootstrap
{
    debootstrap --variant=minbase --components="$components" --force-check-gpg --keyring="$keyring" \
        "$suite" "$root" "$mirror" "${script[@]}"
    printf 'deb %s %s %s\n' "$mirror" "$suite" "${components//,/ }" "$mirror" "$suite-updates" "${components//,/ }" \
        >"$root/etc/apt/sources.list"
    settings_of_apt_and_pip
    inside apt-get -q update
    inside apt-get -q install -y --no-install-recommends git make
    git clone --no-hardlinks . "$root/srv/rvm_mpi"
} >"$logs/$system-root.log" 2>&1 </dev/null || fail "no root: the end of runs/elsewhere/$system-root.log says why"

commit=$(git -C "$root/srv/rvm_mpi" rev-parse --short HEAD)
status=0 answers=()
TIMEFORMAT='%R %U %S'
for target in "${targets[@]}"; do
    log=$logs/$system-$target.log
    say "make $target: runs/elsewhere/$system-$target.log"
    result=passed
    took=$({ time inside make -C /srv/rvm_mpi "$target" >"$log" 2>&1; } 2>&1) || result=FAILED
    [ "$result" = passed ] || status=1
    minutes=$(awk '{ printf "%.1f min (%.1f min of processors)", $1 / 60, ($2 + $3) / 60 }' <<<"${took##*$'\n'}")
    counts=$(grep -E '^=+ .* in [0-9.]+s' "$log" | tail -n 1 | sed -E 's/^=+ | in .*//g' || true)
    answers+=("make $target: $result, $minutes${counts:+, $counts}")
    grep -E '^(FAILED|ERROR) ' "$log" || true
done

say "$system at $commit, $(inside /srv/rvm_mpi/.venv/bin/python -c '
import platform, numba, numpy
from mpi4py import MPI
from petsc4py import PETSc
mpi = MPI.Get_library_version().split(",")[0].removesuffix(chr(0))
petsc = ".".join(map(str, PETSc.Sys.getVersion()))
print(f"Python {platform.python_version()}, NumPy {numpy.__version__}, numba {numba.__version__}, {mpi}, PETSc {petsc}")
' 2>&1 | tail -n 1)"
for answer in "${answers[@]}"; do say "$answer"; done
exit "$status"
