"""The command `rvm` with faults put into it: `program.py FAULT... -- run JOB.toml ...`.

A FAULT is ACTION:POINT:RANK:NUMBER and happens on that rank ("all" for every rank) just before that point is passed
for the NUMBERth time ("each" for every time). Points are functions of the package that a run calls; nothing in the
package itself knows of faults. Actions:

    error       an exception that no one expects
    hdf5        what h5py raises where the disk refuses
    full        from here on the disk takes no more: files cannot grow beyond a kilobyte
    fill        the disk that the run directory lies on is filled to its last byte, really
    device      the history goes to /dev/full
    kill        kill -9 of this rank; SIGTERM, SIGINT, SIGUSR1: that signal to this rank
    hold        the rank makes a file `held` beside the run directory and waits for one `go`
    remove      the run directory is removed, by whoever comes first
    0.05        so many seconds pass
"""

import errno
import os
import resource
import shutil
import signal
import sys
import time
from pathlib import Path

from rvm_mpi import simulation
from rvm_mpi.commands.main import main
from rvm_mpi.job.job import Job
from rvm_mpi.output import checkpoint, rundir
from rvm_mpi.output.fields import FieldsFile
from rvm_mpi.output.history import History
from rvm_mpi.output.restart import Checkpoint
from rvm_mpi.output.xdmf import Xdmf
from rvm_mpi.run import warm
from rvm_mpi.step import stepper as stepping

POINTS = {
    "compile": (warm, "all_compiled"),
    "read": (Job, "from_file"),
    "prepare": (rundir, "prepare"),
    "init": (stepping.KineticStepper, "__init__"),
    "open": (FieldsFile, "__init__"),
    "step": (simulation.Simulation, "advance"),
    "history": (History, "append"),
    "snapshot": (simulation.Simulation, "snapshot"),
    "fields": (FieldsFile, "_write_blocks"),
    "time": (FieldsFile, "_write_time"),
    "xdmf": (Xdmf, "add"),
    "checkpoint": (checkpoint, "write"),
    "create": (checkpoint, "_create"),
    "blocks": (checkpoint, "_write_blocks"),
    "sums": (checkpoint, "checksums"),  # between the blocks
    "flush": (checkpoint, "flush_to_disk"),
    "rename": (Path, "replace"),
    "load": (Checkpoint, "fill"),
}


def rank():
    return int(os.environ.get("OMPI_COMM_WORLD_RANK", "0"))


def fill_disk_of(directory):
    """For small disks: whole blocks, then single bytes, into a file beside the run directory."""
    with (directory.parent / "filler").open("ab", buffering=0) as file:
        for size in (2**16, 2**12, 1):
            try:
                while file.write(bytes(size)) == size:
                    pass
            except OSError as error:
                assert error.errno == errno.ENOSPC


def do(action, arguments, itself):
    directory = Path(arguments[arguments.index("--output") + 1])
    if action == "error":
        raise AssertionError(f"a fault of\n rank {rank()}")
    if action == "hdf5":
        raise OSError("Can't synchronously write data\n (file write failed: errno = 5, error message = 'I/O error')")
    if action == "full":
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
    elif action == "hold":
        (directory.parent / "held").touch()
        while not (directory.parent / "go").exists():
            time.sleep(0.02)
    elif action == "remove":
        shutil.rmtree(directory, ignore_errors=True)
    elif action == "fill":
        fill_disk_of(directory)
    elif action == "device":
        itself._file = Path("/dev/full").open("ab", buffering=0)  # noqa: SIM115
    elif action == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    elif action.startswith("SIG"):
        os.kill(os.getpid(), signal.Signals[action])
    else:
        time.sleep(float(action))


def put_in(fault, arguments):
    """Wrap the function of the point."""
    action, point, where, number = fault.split(":")
    if where not in ("all", str(rank())):
        return
    owner, name = POINTS[point]
    real, passed = getattr(owner, name), 0

    def wrapped(*args, **kwargs):
        nonlocal passed
        passed += 1
        if number == "each" or passed == int(number):
            do(action, arguments, args[0] if args else None)
        return real(*args, **kwargs)

    setattr(owner, name, wrapped)


if __name__ == "__main__":
    end = sys.argv.index("--")
    for fault in sys.argv[1:end]:
        put_in(fault, sys.argv[end + 1 :])
    sys.exit(main(sys.argv[end + 1 :]))
