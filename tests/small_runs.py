"""Small jobs, and commands in processes that no launcher has started."""

import os
import signal
import subprocess
import sys

import tomli_w
from conftest import ROOT

GRANULAR = {"operator": "granular-es-bgk", "knudsen": 0.1, "restitution": 0.9}
#: beginnings of the variables by which launchers tell a process who it is
LAUNCHED = ("OMPI_", "PMIX_", "PMI_", "SLURM_", "MV2_")


def job_text(**tables):
    """A job file; what is not said: a granular gas on 12 x 10 velocities, random density in space."""
    job = {
        "velocity": {"points": [12, 10]},
        "collision": GRANULAR,
        "initial": {"state": "random-density", "low": 0.5},
        **tables,
    }
    return tomli_w.dumps(job)


def environment(**more):
    """Variables for a process of its own."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(LAUNCHED)}
    return {**clean, "PYTHONPATH": str(ROOT), **more}


def shell(script, place, **more):
    """What bash has to say to a script in which `rvm` is a command: status, stdout, stderr."""
    text = f'rvm() {{ "{sys.executable}" -m rvm_mpi "$@"; }}; set -o pipefail\n{script}'
    done = subprocess.run(
        ["bash", "-c", text], cwd=place, env=environment(**more), capture_output=True, timeout=200,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )  # fmt: skip
    return done.returncode, done.stdout.decode(), done.stderr.decode()


def contents(path):
    """Bytes of all files below a folder, by their places in it."""
    return {str(p.relative_to(path)): p.read_bytes() for p in sorted(path.rglob("*")) if p.is_file()}
