"""A run directory: whether it is free, moving an old run aside, `job.toml`, and what produced the run.

Only rank 0 changes anything on disk; `check` may be called by every rank before anything is written.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import subprocess
import sys
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rvm_mpi.job.text import JobError
from rvm_mpi.output import hdf5
from rvm_mpi.output import lock as runlock
from rvm_mpi.output.disk import free_name
from rvm_mpi.terminal import tell

if TYPE_CHECKING:
    from rvm_mpi.job.job import Job

ENDED = "ended: "
"""Beginning of the last line of `run.log`, which says how a run has ended; a killed one has none."""
MARKS = ("job.toml", "fields.h5", "history.csv", "run.log")
"""Files that tell a run directory; checkpoints do too."""
MAY_CHANGE = {"title", "time", "output", "watch"}
"""Tables that a restarted job may have changed: how far a run goes, what it stores and what it watches."""
PLACES = {"initial.run"}
"""Keys that say where something lay when a run started: once it has, they mean nothing."""


def holds_run(path: Path) -> bool:
    """Whether a directory holds a run or what is left of one."""
    return any((path / name).exists() for name in MARKS) or bool(checkpoints(path))


def checkpoints(path: Path) -> list[Path]:
    """Files named as checkpoints, whether they are complete or not, sorted by name."""
    return sorted(path.glob("checkpoint-*.h5"))


def check(path: Path, restart: bool = False, overwrite: bool = False) -> None:
    """Refuse a directory that cannot take this run; writes nothing.

    Raises
    ------
    JobError
        If another run is writing into it, if it holds a run and neither `restart` nor `overwrite` is set, if there is
        nothing to restart from, or if it cannot be a directory that this user may write to.
    """
    try:
        runlock.refuse_live(path)
    except OSError as error:
        raise JobError(f"{path}: cannot be used: {error.strerror or error}") from None
    _check(path, restart, overwrite)


def _check(path: Path, restart: bool, overwrite: bool) -> None:
    """The same for the run that holds the directory."""
    if restart and overwrite:
        raise JobError("--restart and --overwrite exclude each other")
    try:
        if path.exists() and not path.is_dir():
            raise JobError(f"{path}: is not a directory")
        if restart and not holds_run(path):
            raise JobError(f"{path}: nothing to restart: it holds no run")
        if restart and not checkpoints(path):
            raise JobError(f"{path}: nothing to restart from: it holds no checkpoint")
        if not restart and not overwrite and path.exists() and holds_run(path):
            raise JobError(
                f"{path}: holds a run already; --restart goes on with it, --overwrite moves it aside, "
                "--output names another directory"
            )
        _check_writable(path)
    except OSError as error:
        raise JobError(f"{path}: cannot be used: {error.strerror or error}") from None


def _check_writable(path: Path) -> None:
    """The directory, or the nearest one above it that exists, must be a directory and writable."""
    place = path.absolute()
    while not place.exists():
        place = place.parent
    if not place.is_dir():
        raise JobError(f"{path}: {place} is not a directory")
    if not os.access(place, os.W_OK | os.X_OK):
        raise JobError(f"{path}: no permission to write in {place}")


def check_restart(path: Path, job: Job) -> None:
    """Refuse to go on with a run as another job: only `time`, `output`, `watch` and `title` may differ.

    Raises
    ------
    JobError
        Naming the keys that differ, or if `job.toml` cannot be read.
    """
    from rvm_mpi.job.job import Job

    differing = differing_keys(Job.from_file(path / "job.toml"), job)
    if differing:
        raise JobError(
            f"{path}: cannot restart as another job: {'; '.join(differing)}; "
            "only time, output, watch and title may change"
        )


def differing_keys(before: Job, now: Job) -> list[str]:
    """What a restart may not change and `now` has otherwise: "space.cells is [16], was [8]" for each such key."""
    old, new = (_flat(job.model_dump(mode="json", exclude=MAY_CHANGE)) for job in (before, now))
    keys = [key for key in dict.fromkeys([*old, *new]) if key not in PLACES]
    return [
        f"{key} is {_shown(new.get(key))}, was {_shown(old.get(key))}" for key in keys if old.get(key) != new.get(key)
    ]


def _flat(tables: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in tables.items():
        flat.update(_flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value})
    return flat


def _shown(value: Any) -> str:
    return "not given" if value is None else json.dumps(value)


def prepare(
    path: Path, job: Job, restart: bool = False, overwrite: bool = False, lock: runlock.Lock | None = None
) -> Path | None:
    """Make the directory ready for a run and write `job.toml`; for rank 0 alone.

    An old run is moved, whole, to `NAME-old-1` (or the next free number), never deleted; with `restart` an
    older `job.toml` that differs is kept as `job-1.toml` (or the next free number).

    Parameters
    ----------
    path : Path
    job : Job
    restart, overwrite : bool
    lock : Lock, optional
        Of the directory; where the old run is moved it stays with the new one.

    Returns
    -------
    Path or None
        Where the old run went, if there was one in the way.

    Raises
    ------
    JobError
        As `check` and `check_restart`, or if the disk refuses.
    """
    _check(path, restart, overwrite)
    path, aside = path.resolve(), None  # a link to another disk stays one, and "." stays this place
    try:
        if restart:
            check_restart(path, job)
            if (path / "job.toml").read_text(encoding="utf-8") != job.to_toml():
                (path / "job.toml").rename(free_name(path / "job", ".toml"))
        elif overwrite and path.exists() and holds_run(path):
            aside = free_name(path.with_name(f"{path.name}-old"))
            path.rename(aside)
            path.mkdir(exist_ok=True)
            if lock is not None:
                try:
                    lock.follow(aside)
                except JobError as error:
                    raise JobError(f"{error}; the run that was there is now in {aside}") from None
        path.mkdir(parents=True, exist_ok=True)
        part = path / "job.toml.part"
        part.write_text(job.to_toml(), encoding="utf-8")
        part.replace(path / "job.toml")
    except OSError as error:
        raise JobError(f"{path}: cannot be used: {error.strerror or error}") from None
    return aside


class Log:
    """`run.log`, for rank 0. Where it cannot be written that is said once, and the run goes on without it.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        # without a buffer nothing stays behind in the process that closing would try again
        self._file: Any = path.open("ab", buffering=0)

    def write(self, text: str) -> None:
        """Append a text."""
        if self._file is None:
            return
        try:
            self._file.write(text.encode(errors="replace"))
        except OSError as error:
            self.close()
            tell(f"rvm: {self._path} cannot be written: {error.strerror}; going on")

    @staticmethod
    def note_end(directory: Path, how: str) -> None:
        """Write a run's last line where its log is not open, if it has one."""
        path = directory / "run.log"
        with contextlib.suppress(OSError):
            if path.is_file():
                with path.open("ab", buffering=0) as file:
                    file.write(f"{ENDED}{how}\n".encode(errors="replace"))

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Close it; a second call does nothing."""
        if self._file is not None:
            self._file.close()
            self._file = None


def provenance(ranks: int) -> dict[str, str]:
    """What produced a run, as attributes of its results: versions, commit, ranks, machine, start time."""
    from rvm_mpi import __version__

    _load_hdf5()
    facts = {
        "version": __version__,
        "git_commit": git_commit(),
        "ranks": str(ranks),
        "started": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "machine": f"{platform.node()}, {processor()}, {platform.system()} {platform.release()}",
        "python": platform.python_version(),
    }
    for module in ("numpy", "numba", "mpi4py", "petsc4py", "h5py", "scipy", "pydantic"):
        facts[module] = library_version(module)
    facts["mpi"], facts["petsc"], facts["hdf5"] = _mpi(), _petsc(), _hdf5()
    return facts


def library_version(module: str) -> str:
    """Version of an imported module, else of the installed package, else "not installed"."""
    loaded = sys.modules.get(module)
    if loaded is not None and hasattr(loaded, "__version__"):
        return str(loaded.__version__)
    try:
        return metadata.version(module)
    except metadata.PackageNotFoundError:
        return "not installed"


def git_commit() -> str:
    """Commit of the source tree this package is imported from, "-dirty" if changed; "unknown" outside one."""
    here = Path(__file__).resolve().parent

    def git(*arguments: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(here), *arguments], capture_output=True, text=True, timeout=10, check=True
        )
        return done.stdout.strip()

    try:
        git("ls-files", "--error-unmatch", "__init__.py")
        return git("rev-parse", "HEAD") + ("-dirty" if git("status", "--porcelain", "--", ".") else "")
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def processor() -> str:
    """The processor's name and how many of its cores this process may use."""
    name = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                name = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{name} ({cores} {'core' if cores == 1 else 'cores'})"


def _mpi() -> str:
    if "mpi4py.MPI" not in sys.modules:
        return "not loaded"
    return one_line(sys.modules["mpi4py.MPI"].Get_library_version())


def _petsc() -> str:
    if "petsc4py.PETSc" not in sys.modules:
        return "not loaded"
    return ".".join(map(str, sys.modules["petsc4py.PETSc"].Sys.getVersion()))


def _load_hdf5() -> None:
    """Load h5py as the results do, so that its version is known before they are opened."""
    with contextlib.suppress(ImportError):
        hdf5.import_h5py()


def _hdf5() -> str:
    return sys.modules["h5py"].version.hdf5_version if "h5py" in sys.modules else "not loaded"


def one_line(text: str) -> str:
    """The text's first line, without the padding of C strings."""
    return text.replace("\0", "").strip().split("\n")[0].strip()
