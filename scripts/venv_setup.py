"""Fit .venv to the system's libraries: used by install.sh, run by .venv's own Python.

prepare   writes constraints.txt (pip leaves the system's numpy and its kin alone) and a .pth file that
          makes petsc4py and the MPI build of h5py importable without any environment variable
check     imports them all, each from the system, and says what is wrong in one line
"""

import importlib
import importlib.metadata
import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

SYSTEM = ["numpy", "scipy", "numba", "llvmlite", "mpi4py", "petsc4py", "h5py", "pyfftw", "xarray", "pandas", "matplotlib"]

# One line, as .pth files demand. Debian keeps petsc4py outside Python's path, beside its PETSc; its h5py
# loads the serial build unless told. User packages (~/.local) would come before the system's: left out.
PTH = """\
import os, site; site.ENABLE_USER_SITE = False; os.environ.setdefault("H5PY_ALWAYS_USE_MPI", "1")
import os; os.path.isdir(os.environ.get("PETSC_DIR", "") + "/lib/python3/dist-packages/petsc4py") or os.environ.update(PETSC_DIR={petsc_dir!r})
import os, sys; sys.path.append(os.environ["PETSC_DIR"] + "/lib/python3/dist-packages")
"""


def petsc_dir() -> str:
    """Return the newest of the system's PETSc builds for real numbers and 32-bit indices that has petsc4py."""

    def version(path: Path) -> list[int]:
        return [int(number) for number in re.findall(r"\d+", path.parent.name)]

    builds = [
        build
        for build in Path("/usr/lib/petscdir").glob("petsc[0-9].*/*-real")
        if (build / "lib/python3/dist-packages/petsc4py").is_dir()
    ]
    if not builds:
        raise SystemExit("rvm_mpi: no petsc4py under /usr/lib/petscdir: is python3-petsc4py installed?")
    return str(max(builds, key=version))


def prepare() -> None:
    """Write constraints.txt and rvm_mpi_system.pth."""
    site_packages = Path(sysconfig.get_path("purelib"))
    pth = site_packages / "rvm_mpi_system.pth"
    temporary = pth.with_suffix(".new")
    temporary.write_text(PTH.format(petsc_dir=petsc_dir()))
    temporary.replace(pth)

    system = [path for path in sys.path if "dist-packages" in path]
    names = {name.lower() for name in SYSTEM}
    held = {
        f"{name}=={distribution.version}"
        for distribution in importlib.metadata.distributions(path=system)
        if (name := (distribution.metadata["Name"] or "").lower()) in names
    }
    (Path(sys.prefix) / "constraints.txt").write_text("\n".join(sorted(held)) + "\n")


def check() -> None:
    """Import every compiled library as a run would, and the MPI build of h5py."""
    wrong = []
    for name in SYSTEM:
        if name == "petsc4py":
            name = "petsc4py.PETSc"
        try:
            module = importlib.import_module(name)
        except Exception as error:  # a library built for another numpy raises whatever it likes
            wrong.append(f"{name}: {error}")
            continue
        path = str(module.__file__)
        if not path.startswith("/usr/lib/"):
            wrong.append(f"{name} is {path}, not the system's")
    if "h5py" in sys.modules and not sys.modules["h5py"].get_config().mpi:
        wrong.append("h5py is the serial build, not python3-h5py-mpi's")
    if wrong:
        raise SystemExit("rvm_mpi: " + "; ".join(wrong))


if __name__ == "__main__":
    {"prepare": prepare, "check": check}[sys.argv[1]]()
