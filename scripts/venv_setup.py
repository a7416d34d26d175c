"""Fit .venv to the system's libraries: used by install.sh, run by .venv's own Python.

prepare   writes constraints.txt (pip leaves the system's numpy and its kin alone) and a .pth file that
          makes petsc4py and the MPI build of h5py importable without any environment variable
check     imports them all, each from the system, and says what is wrong in one line
"""

import importlib
import importlib.metadata
import re
import sys
import sysconfig
from pathlib import Path

SYSTEM = ["numpy", "scipy", "mpi4py", "petsc4py", "h5py", "xarray", "pandas", "matplotlib"]
SYSTEM_OR_PIP = ["numba", "llvmlite", "pyfftw"]  # not in every release of Debian and Ubuntu

# Debian keeps petsc4py outside Python's path, beside its PETSc; its h5py loads the serial build unless told;
# packages in ~/.local would come before the system's.
PTH = """\
import site; site.ENABLE_USER_SITE = False
import os; os.environ.setdefault("H5PY_ALWAYS_USE_MPI", "1")
import os; os.environ["PETSC_DIR"] = {petsc_dir!r}
{petsc_dir}/lib/python3/dist-packages
"""


def petsc_dir() -> str:
    """Return the newest of the system's PETSc builds (real numbers, 32-bit indices) with petsc4py."""

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
    names = {*SYSTEM, *SYSTEM_OR_PIP} - {"xarray"}  # pure Python, and packaged with odd version numbers
    held = {
        f"{name}=={distribution.version}"
        for distribution in importlib.metadata.distributions(path=system)
        if (name := (distribution.metadata["Name"] or "").lower()) in names
    }
    (Path(sys.prefix) / "constraints.txt").write_text("\n".join(sorted(held)) + "\n")


def check() -> None:
    """Import every compiled library as a run would, and the MPI build of h5py."""
    wrong = []
    for name in [*SYSTEM, *SYSTEM_OR_PIP]:
        try:
            module = importlib.import_module("petsc4py.PETSc" if name == "petsc4py" else name)
        except Exception as error:  # a library built for another numpy raises whatever it likes
            wrong.append(f"{name}: {error}")
            continue
        homes = ["/usr/lib/", *([sys.prefix] if name in SYSTEM_OR_PIP else [])]
        if not str(module.__file__).startswith(tuple(homes)):
            wrong.append(f"{name} is {module.__file__}, not the system's")
    if "h5py" in sys.modules and not sys.modules["h5py"].get_config().mpi:
        wrong.append("h5py is the serial build, not python3-h5py-mpi's")
    if wrong:
        raise SystemExit("rvm_mpi: " + "; ".join(wrong))


if __name__ == "__main__":
    {"prepare": prepare, "check": check}[sys.argv[1]]()
