#!/bin/bash
# mpirun, but a run that is told to stop stops with a checkpoint: Ctrl-C, SIGTERM, SIGHUP (the terminal is closed)
# and SIGUSR1 reach the ranks as SIGUSR1, and the exit status is rvm's own. The arguments are mpirun's:
#
#   jobs/mpirun.sh -n 2 .venv/bin/rvm run jobs/test4_clustering.toml
#
# Open MPI's mpirun answers Ctrl-C and SIGTERM by killing the ranks within two seconds, before they are through a
# checkpoint; so does a second Ctrl-C here. MPIRUN in the environment names another mpirun than that which Debian's Python
# modules are built with.
set -euo pipefail

if [ "$(id -u)" = 0 ]; then # Open MPI refuses root unless told
    export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
fi
asked='' interrupted=''
# shellcheck disable=SC2317  # called by the traps
stop() { # the signal that mpirun gets
    interrupted=yes
    kill -s "$1" "$!" 2>/dev/null || true
}
trap 'stop "${asked:-USR1}"; asked=TERM' INT
trap 'stop USR1' TERM HUP USR1

export RVM_MPIRUN=$0 # for the line that says how to go on

# a session of its own: Ctrl-C goes to all processes of a terminal
mpirun=${MPIRUN:-$(command -v mpirun.openmpi || echo mpirun)}
setsid "$mpirun" "$@" </dev/null &
while # a signal ends the wait, not the run
    interrupted='' status=0
    wait "$!" || status=$?
    [ -n "$interrupted" ]
do :; done
exit "$status"
