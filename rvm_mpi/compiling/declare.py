"""How kernels are declared, and where their machine code is kept between runs.

A *kernel* is called from Python and calls *parts*; both are compiled by numba as its documentation says, and allocate
nothing: work space is passed to them. Their arithmetic rounds as IEEE 754 says, operation by operation (`simd.fma` is
the one that rounds a product and a sum together), so that bits follow from the source alone.

Machine code lies in `kernels/` of the user's cache directory (`cache.py`), or of $NUMBA_CACHE_DIR where that is set, in
a directory named by a hash of all that it depends on: the package's sources, the versions of what compiles it, the
processor. numba's own cache there notices no change in a function called from another file; the name does.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, update_wrapper
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numba
import numba.extending
import numpy as np

from rvm_mpi.cache import cache_directory
from rvm_mpi.job.text import JobError

if numba.config.DISABLE_JIT:
    raise JobError("NUMBA_DISABLE_JIT is set (environment or .numba_config.yaml): kernels must be compiled; unset it")

OPTIONS = {"error_model": "numpy", "nogil": True}
#: directories of kernels that are kept: of the last sources and processors in use, some MB each
KEPT = 20
#: in a directory of kernels: all that the package has were compiled
ALL_COMPILED = "all-compiled"
#: what a damaged or a full cache leads to; no kernel raises any of these itself
_CACHE_FAILS = (OSError, EOFError, pickle.UnpicklingError)


class Kernel:
    """A function that Python calls, compiled at its first call with such arguments, or read from disk.

    A cache that cannot be read or written costs the time to compile, nothing else.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        update_wrapper(self, function)
        self.function = function
        self._compiled = _kept(function)

    def __call__(self, *arguments: Any) -> Any:
        """Run it."""
        arguments = tuple(_typed(one) if isinstance(one, tuple) else one for one in arguments)
        try:
            return self._compiled(*arguments)
        except _CACHE_FAILS:
            self._compiled = numba.njit(**OPTIONS)(self.function)
            return self._compiled(*arguments)


class _Typed(tuple):
    """The entries of a NamedTuple together with the type that it has in kernels.

    numba finds out the types of all arguments at each call. Debian 12's, 0.56, reads memory that was never set where
    the description of one is longer than 40 bytes (`string_writer_ensure` in its C sources), as that of a NamedTuple
    is, and may not know it again: the call then takes a millisecond more, and memory that is never given back. What it
    does not know it asks `typeof_impl` for, each time.
    """

    kernel_type: Any


@numba.extending.typeof_impl.register(_Typed)
def _type_of(value: _Typed, _context: Any) -> Any:
    return value.kernel_type


_TYPES: dict[Any, Any] = {}


def _typed(value: Any) -> _Typed:
    kind = _kind(value)
    found = _TYPES.get(kind)
    if found is None:
        found = _TYPES[kind] = numba.typeof(value)
    typed = _Typed(value)
    typed.kernel_type = found
    return typed


def _kind(value: Any) -> Any:
    """What the type of a value depends on."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.ndim, value.flags.num
    if isinstance(value, tuple):
        return (type(value), *map(_kind, value))
    return type(value)


def kernel(function: Callable[..., Any]) -> Kernel:
    """Declare a function that Python calls to be compiled."""
    return Kernel(function)


def part(function: Callable[..., Any]) -> Any:
    """Declare a function that kernels and other parts call; from Python it can be called too, as tests do."""
    return numba.njit(**OPTIONS)(function)


def _kept(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function compiled by numba, its machine code kept in `kept_in`."""
    directory = kept_in()
    # what lies outside the package is not in the hash of its sources
    if directory is None or not function.__module__.startswith("rvm_mpi."):
        return numba.njit(**OPTIONS)(function)  # type: ignore[no-any-return]
    others = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(directory)
    try:
        return numba.njit(cache=True, **OPTIONS)(function)  # type: ignore[no-any-return]
    finally:
        numba.config.CACHE_DIR = others


@cache
def kept_in() -> Path | None:
    """The directory of kernels for these sources and this processor; None where there can be none."""
    try:
        base = Path(numba.config.CACHE_DIR) if numba.config.CACHE_DIR else cache_directory()
        path = base / "kernels" / _depends_on()
        if not path.is_dir():
            path.mkdir(parents=True, exist_ok=True)
            _forget_oldest(path.parent)
    except (OSError, RuntimeError):
        return None
    return path if os.access(path, os.W_OK | os.X_OK) else None


def all_compiled() -> bool:
    """Whether all of the package's kernels are on disk, or there is no place to keep them."""
    directory = kept_in()
    return directory is None or (directory / ALL_COMPILED).exists()


def note_all_compiled() -> None:
    """Leave a note that they are."""
    directory = kept_in()
    if directory is not None:
        with suppress(OSError):
            (directory / ALL_COMPILED).touch()


def _depends_on() -> str:
    """A hash of all that the machine code of kernels depends on."""
    root = Path(__file__).parent.parent
    sources = [(str(path.relative_to(root)), path.read_bytes()) for path in sorted(root.rglob("*.py"))]
    versions = (numba.__version__, llvmlite.__version__, np.__version__, sys.implementation.cache_tag)
    features = sorted(name for name, there in llvm.get_host_cpu_features().items() if there)
    processor = (llvm.get_host_cpu_name(), features, numba.config.CPU_NAME, numba.config.CPU_FEATURES)
    return hashlib.sha256(repr((sources, versions, processor)).encode()).hexdigest()[:32]


def _forget_oldest(directory: Path) -> None:
    """Leave the newest of the directories of kernels; one in use that goes is made again."""
    with suppress(OSError):
        for old in sorted(directory.iterdir(), key=lambda one: one.stat().st_mtime)[:-KEPT]:
            shutil.rmtree(old, ignore_errors=True)
