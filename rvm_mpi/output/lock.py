"""Who writes into a run directory: one run at a time, by a file `lock` in it that names its owner.

The file comes into being whole and only where there is none (a hard link, where the file system has them), which
holds on NFS and Lustre as on a local disk; `flock` may be missing there, or hold on one node only. It goes with the
end of the run, however it ends, but for a kill. What a killed run has left is told by its owner's process, on the
machine where that ran, and elsewhere by the time since the owner last touched the file.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import platform
import tempfile
import threading
import uuid
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path

from rvm_mpi.job.text import JobError

FILE = "lock"
BEAT = 15.0
"""Seconds between two signs of life."""
SILENCE = 300.0
"""Seconds without a sign of life after which a run on another machine counts as gone: many beats, and longer than
network file systems keep old times of files."""
REBOOTED = 60.0
"""The same where that machine has this one's name but was started at another time."""
NO_LINKS = {errno.EPERM, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}
ATTEMPTS = 20


@dataclass(frozen=True)
class Owner:
    """A process that writes into a run directory: rank 0 of a run.

    Attributes
    ----------
    id : str
        Of this lock; no other has it.
    host, pid : str, int
    started : str
        When the process started, in the kernel's own count; process ids are used again.
    boot, namespace : str
        Of the running kernel and of the set of processes in which `pid` counts; empty where the system does not say.
    since : str
        Date and time.
    slurm_job, slurm_restart : str, int
        Number of the SLURM job and how often it was put back into the queue.
    """

    id: str = ""
    host: str = ""
    pid: int = 0
    started: str = ""
    boot: str = ""
    namespace: str = ""
    since: str = ""
    slurm_job: str = ""
    slurm_restart: int = 0

    @classmethod
    def this_process(cls) -> Owner:
        """The process that asks, with a new id."""
        restarts = os.environ.get("SLURM_RESTART_COUNT", "0")
        return cls(
            id=uuid.uuid4().hex,
            host=platform.node(),
            pid=os.getpid(),
            started=_start_of(os.getpid()) or "",
            boot=_text_of("/proc/sys/kernel/random/boot_id"),
            namespace=_namespace(),
            since=datetime.now(timezone.utc).isoformat(timespec="seconds"),
            slurm_job=os.environ.get("SLURM_JOB_ID", ""),
            slurm_restart=int(restarts) if restarts.isdecimal() else 0,
        )

    def named(self) -> str:
        """In words."""
        if not self.id:
            return "a run that has not said who it is"
        job = f", SLURM job {self.slurm_job}" if self.slurm_job else ""
        return f"a run on {self.host} (process {self.pid}{job}, since {self.since})"

    def runs(self, age: Callable[[], float]) -> bool:
        """Whether it is still there, as far as can be told from here.

        Parameters
        ----------
        age : callable
            Seconds since its last sign of life; asked only where its process cannot be.
        """
        alive = self.runs_here()
        if alive is not None:
            return alive
        here = Owner.this_process()
        if self.slurm_job and self.slurm_job == here.slurm_job and self.slurm_restart < here.slurm_restart:
            return False  # SLURM puts a job back into the queue when nothing of it is left
        return age() < (REBOOTED if self.host == here.host and self.boot != here.boot else SILENCE)

    def runs_here(self) -> bool | None:
        """Whether its process is there; None if that cannot be known on this machine."""
        if not self.id or (self.host, self.boot, self.namespace) != (platform.node(), *_machine()):
            return None
        start = _start_of(self.pid)
        return start is not None and (start == self.started or not start or not self.started)


def _text_of(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except OSError:
        return ""


def _namespace() -> str:
    try:
        return str(Path("/proc/self/ns/pid").readlink())
    except OSError:
        return ""


def _machine() -> tuple[str, str]:
    return _text_of("/proc/sys/kernel/random/boot_id"), _namespace()


def _start_of(pid: int) -> str | None:
    """When a process started, "" if that is not said; None if there is none."""
    if pid <= 0:
        return None
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return None
    except PermissionError:  # somebody else's, and there
        pass
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        state, *rest = text.rpartition(")")[2].split()  # the name before it may hold anything
    except (OSError, ValueError):
        return ""
    return None if state in "ZX" else rest[18]


def read(path: Path) -> Owner | None:
    """The owner that a lock file names, with no id if it cannot be read; None if there is no file."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except (FileNotFoundError, NotADirectoryError):
        return None
    try:
        found = json.loads(text)
        return Owner(**{name: type(value)(found[name]) for name, value in asdict(Owner()).items()})
    except (ValueError, KeyError, TypeError):
        return Owner()


def refuse_live(directory: Path) -> None:
    """Refuse a directory into which a run writes of which this machine knows that it is there; changes nothing.

    Raises
    ------
    JobError
        Naming the run and how to stop it.
    """
    owner = read(directory / FILE)
    if owner is not None and owner.runs_here():
        raise JobError(_in_use(directory, owner))


def _in_use(directory: Path, owner: Owner) -> str:
    words = f"{directory}: {owner.named()} is writing into it; wait for its end, or stop it by: touch {directory}/stop"
    if owner.runs_here() is None:
        words += f"; if it is gone for certain, remove {directory / FILE} (without a sign of life it is taken for gone "
        words += f"after {SILENCE:.0f} s)"
    return words


def seconds_of_silence(path: Path) -> float:
    """Seconds since a lock file was last touched, by the clock of the file system that it lies on."""
    # opened anew, a network file system asks its server
    with path.open("rb") as file, tempfile.NamedTemporaryFile(dir=path.parent, prefix=f"{FILE}.") as now:
        return os.fstat(now.fileno()).st_mtime - os.fstat(file.fileno()).st_mtime


class Lock:
    """A run directory held by this process, until `release`.

    Parameters
    ----------
    directory : Path
        Must be there.

    Raises
    ------
    JobError
        If another run has it.
    OSError
        If the directory cannot be written to.
    """

    def __init__(self, directory: Path) -> None:
        self.path = directory / FILE
        self.owner = Owner.this_process()
        self._acquire()
        # by its descriptor a sign of life never reaches the lock of a run that has taken the directory over
        self._descriptor = os.open(self.path, os.O_RDONLY)
        self._end = threading.Event()
        # kernels, MPI and HDF5 leave this thread its time: long steps and checkpoints show signs of life
        self._thread = threading.Thread(target=self._beat, name="signs of life", daemon=True)
        self._thread.start()

    def _acquire(self) -> None:
        for _ in range(ATTEMPTS):
            if _create(self.path, self.owner):
                return
            other = read(self.path)
            if other is None:  # it has just ended
                continue
            if other.runs(lambda: _silence(self.path)):
                raise JobError(_in_use(self.path.parent, other))
            with _guarded(self.path, self.owner):
                if read(self.path) == other:
                    _replace(self.path, self.owner)
                    return
        raise JobError(f"{self.path.parent}: {self.path} comes and goes: other runs begin and end in it")

    def _beat(self) -> None:
        while not self._end.wait(BEAT):
            with contextlib.suppress(OSError):
                os.utime(self._descriptor)  # the file system's own time

    def held(self) -> bool:
        """Whether the directory of that name is still this run's."""
        return read(self.path) == self.owner

    def follow(self, aside: Path) -> None:
        """Lock the new directory of the same name, once the one that was locked has been moved.

        Raises
        ------
        JobError
            If another run was quicker.
        """
        if not _create(self.path, self.owner):
            raise JobError(_in_use(self.path.parent, read(self.path) or Owner()))
        descriptor, self._descriptor = self._descriptor, os.open(self.path, os.O_RDONLY)
        os.close(descriptor)
        (aside / FILE).unlink()

    def release(self) -> None:
        """Give the directory up, if it is still this run's."""
        self._end.set()
        self._thread.join()
        os.close(self._descriptor)
        remove(self.path, self.owner)


def remove(path: Path, owner: Owner) -> None:
    """Remove a lock file if it is this owner's."""
    with contextlib.suppress(OSError):
        if read(path) == owner:
            path.unlink()


def _silence(path: Path) -> float:
    try:
        return seconds_of_silence(path)
    except FileNotFoundError:
        return 0.0  # it has just ended: the next attempt finds out


def _written_aside(path: Path, owner: Owner) -> Path:
    part = path.with_name(f"{path.name}.{owner.id}")
    try:
        with part.open("x", encoding="utf-8") as file:
            json.dump(asdict(owner), file)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        part.unlink(missing_ok=True)
        raise
    return part


def _replace(path: Path, owner: Owner) -> None:
    _written_aside(path, owner).replace(path)


def _create(path: Path, owner: Owner) -> bool:
    """Make a lock file if there is none; whether it was made."""
    part = _written_aside(path, owner)
    try:
        os.link(part, path)
    except OSError as error:
        if error.errno == errno.EEXIST:
            return read(path) == owner  # a server that was asked twice says so of one's own
        if error.errno not in NO_LINKS:
            raise
        return _create_in_place(path, part)
    finally:
        part.unlink()
    return True


def _create_in_place(path: Path, part: Path) -> bool:
    """The same where there are no hard links; for a moment the file is there and empty."""
    try:
        with path.open("xb") as file:
            file.write(part.read_bytes())
            file.flush()
            os.fsync(file.fileno())
    except FileExistsError:
        return False
    return True


@contextlib.contextmanager
def _guarded(path: Path, owner: Owner) -> Iterator[None]:
    """Of those that find the same lock left behind, one at a time: else one could take away what another has just made.

    Raises
    ------
    JobError
        If another run is about it.
    """
    guard = path.with_name(f"{FILE}.taken-over")
    if not _create(guard, owner):
        other = read(guard) or Owner()
        if other.runs(lambda: _silence(guard)):
            raise JobError(_in_use(path.parent, other))
        # killed in the thousandth of a second in which it had the guard
        remove(guard, other)
        if not _create(guard, owner):
            raise JobError(_in_use(path.parent, read(guard) or Owner()))
    try:
        yield
    finally:
        remove(guard, owner)
