"""How kernels are declared, compiled and kept between runs.

A *kernel* is called from Python. Its machine code is made in one go from itself and all the *parts* it calls, which
belong to it alone: no other kernel's copy can take their place, so its bits do not depend on what else was compiled, in
which order, or came from disk. A *part* is called by kernels and other parts; numba translates it once a process and
leaves it to each kernel to optimise its own copy. Called from Python, as the tests do, a part is compiled as a kernel.
Kernels and parts allocate nothing: work space is passed to them.

What takes the time is numba's translation, in Python, not LLVM's optimisation. So what it asks again and again it is
told from memory here, what kernels do not use is left out, and elements of arrays are written shorter than it would.
All this is within the compilations of kernels: other users of numba in the process see nothing of it.

The machine code of the package's kernels is kept in `kernels/` of the user's cache directory (`cache.py`), or of
$NUMBA_CACHE_DIR where that is set, in a directory named by a hash of all that it depends on: the package's sources, the
versions of what compiles it, the processor. Files appear whole or not at all. Whoever compiles a kernel holds a
lock on its file meanwhile, so that of the ranks that start together one compiles and the others read. A cache that
cannot be read or written costs the time to compile, nothing else.
"""

from __future__ import annotations

import copy
import fcntl
import gc
import hashlib
import operator
import pickle
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, cached_property, partial, update_wrapper
from pathlib import Path
from typing import IO, Any

import llvmlite
import numba
import numpy as np
from llvmlite.binding import Linkage
from numba import _dynfunc, njit
from numba.core import compiler_machinery, interpreter, ssa, types
from numba.core.caching import _Cache
from numba.core.callconv import CPUCallConv
from numba.core.cgutils import pack_array, unpack_tuple
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, CompileResult, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import LoweringPass, register_pass
from numba.core.ir import FunctionIR
from numba.core.postproc import PostProcessor
from numba.core.registry import cpu_target
from numba.core.serialize import dumps
from numba.core.transforms import canonicalize_cfg
from numba.core.typed_passes import NativeLowering
from numba.extending import _Intrinsic, models, register_model

from rvm_mpi.cache import cache_directory, write_whole
from rvm_mpi.job.text import JobError

if numba.config.DISABLE_JIT:
    raise JobError("NUMBA_DISABLE_JIT is set (environment or .numba_config.yaml): kernels must be compiled; unset it")

#: directories of kernels that are kept: of the last sources and processors in use, some MB each
KEPT = 20
#: seconds after which a rank no longer waits for another one to compile
PATIENCE = 300.0
#: passes of numba's for what kernels do not use: closures, expressions of whole arrays, `with` blocks, values taken as
#: literals, functions to be written in place, reports
_NEEDLESS = {
    "with_lifting",
    "inline_closure_likes",
    "rewrite_semantic_constants",
    "make_function_op_code_to_jit_function",
    "inline_inlinables",
    "find_literally",
    "literal_unroll",
    "LiteralPropagation",
    "inline_overloads",
    "nopython_rewrites",
    "nopython_supported_feature_validation",
    "ir_legalization",
    "dump_parfor_diagnostics",
}
#: functions of numbers, vectors and arrays whose result does not depend on which number an argument is
_FUNCTIONS = {abs, max, min, range} | {
    getattr(operator, name)
    for name in (
        "add", "sub", "mul", "truediv", "iadd", "isub", "imul", "itruediv", "neg",
        "lt", "le", "gt", "ge", "eq", "ne", "getitem", "setitem",
    )
}  # fmt: skip


# -- declaring ------------------------------------------------------------------------------------------------


def kernel(function: Any = None, *, fused: bool = True) -> Any:
    """Declare a function that Python calls to be compiled.

    Parameters
    ----------
    fused : bool
        Whether products and sums may be contracted to fused multiply-adds; nothing else is reordered.
    """
    if function is None:
        return lambda declared: kernel(declared, fused=fused)
    compiled = njit(pipeline_class=_KernelCompiler, **_options(fused))(function)
    if function.__module__.startswith("rvm_mpi."):  # what lies outside the package is not in the hash of its sources
        compiled._cache = _Kept(function)
    return compiled


class Part:
    """A function that kernels and other parts call: numba sees it as such, Python as a kernel."""

    def __init__(self, function: Callable[..., Any], fused: bool) -> None:
        update_wrapper(self, function)
        #: the function itself, for what Python works out of a few numbers: not worth a kernel
        self.plain = function
        self._fused = fused

    @cached_property
    def _part(self) -> Any:
        return njit(pipeline_class=_PartCompiler, no_cpython_wrapper=True, **_options(self._fused))(self.plain)

    @cached_property
    def _numba_type_(self) -> types.Type:
        return _PartType(self._part)

    @cached_property
    def _kernel(self) -> Any:
        return kernel(self.plain, fused=self._fused)

    def __call__(self, *arguments: Any) -> Any:
        """Run it as a kernel."""
        return self._kernel(*arguments)


def part(function: Any = None, *, fused: bool = True) -> Any:
    """Declare a function that kernels call; as `kernel`."""
    return (lambda declared: Part(declared, fused)) if function is None else Part(function, fused)


class _PartType(types.Dispatcher):
    """A part as numba sees it: compiled once for a type, not anew for each literal of that type."""

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        return super().get_call_type(context, tuple(map(types.unliteral, args)), kws)


class Direct:
    """A kernel that is only ever called with arguments of the same types, which are looked at in the first call alone.

    numba otherwise works out the types of tuples anew at each call, half a millisecond for those of a sweep.
    """

    def __init__(self, compiled: Any) -> None:
        self._compiled = compiled
        self._code: Callable[..., Any] | None = None

    def prepare(self, *arguments: Any) -> Callable[..., Any]:
        """Compile it for such arguments, or read it from disk, without running it."""
        if self._code is None:
            self._code = self._compiled.compile(tuple(map(numba.typeof, arguments)))
        return self._code

    def __call__(self, *arguments: Any) -> Any:
        """Run it."""
        return self.prepare(*arguments)(*arguments)


def _options(fused: bool) -> dict[str, Any]:
    return {
        "error_model": "numpy",
        "fastmath": {"contract", "nsz"} if fused else {"nsz"},
        "nogil": True,
        "no_cfunc_wrapper": True,
        "_nrt": False,  # numba's reference counts, which are for what kernels allocate
    }


# -- compiling ------------------------------------------------------------------------------------------------


class _PartLibrary(JITCodeLibrary):
    """A part's code as translated: put together with that of the parts it calls, optimised, only within a kernel."""

    def _optimize_functions(self, module: Any) -> None:
        pass

    def finalize(self) -> None:
        for function in self._final_module.functions:
            if not function.is_declaration:
                function.linkage = Linkage.linkonce_odr
        self._shared_module = self._final_module
        self._finalized = True


class _KernelLibrary(JITCodeLibrary):
    """A kernel's code with its own copy of all its parts."""

    def _optimize_functions(self, module: Any) -> None:
        pass

    def finalize(self) -> None:
        reached: list[Any] = self._linking_libraries
        for library in reached:
            if isinstance(library, _PartLibrary):
                reached += [one for one in library._linking_libraries if one not in reached]
        super().finalize()

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr:
                function.linkage = Linkage.internal
        super()._optimize_final_module()


class _Known(types.Function):
    """A function of numba's or `simd.py`'s, whose type for given arguments is asked for once."""

    def __init__(self, own: types.Function) -> None:
        super().__init__(own.templates)
        self.own = own
        self._found: dict[Any, Any] = {}

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        arguments = tuple(map(types.unliteral, args))
        if arguments not in self._found:
            self._found[arguments] = super().get_call_type(context, arguments, kws)
        return self._found[arguments]


class _Typing(type(cpu_target.typing_context)):  # type: ignore[misc]
    """numba's rules for types: it tries dozens of them, for lists, strings and whole arrays, at each sum of numbers."""

    known: dict[Any, _Known] = {}  # noqa: RUF012

    def _lookup_global(self, gv: Any) -> Any:
        own = super()._lookup_global(gv)
        ours = isinstance(gv, _Intrinsic) and gv.__module__.startswith("rvm_mpi.")
        if type(own) is not types.Function or not (ours or gv in _FUNCTIONS):
            return own
        if gv not in self.known or self.known[gv].own is not own:
            self.known[gv] = _Known(own)
        return self.known[gv]


class _Whole:
    """Arguments as one value each: numba takes tuples and arrays to pieces and puts them together again."""

    def __init__(self, manager: Any, kinds: Any) -> None:
        self.argument_types = tuple(manager.lookup(kind).get_value_type() for kind in kinds)

    def as_arguments(self, builder: Any, values: Any) -> Any:
        return [
            value if value.type == kind else pack_array(builder, unpack_tuple(builder, value))
            for value, kind in zip(values, self.argument_types, strict=True)  # any number of them is a tuple to numba
        ]

    def from_arguments(self, builder: Any, values: Any) -> Any:
        return values

    def assign_names(self, values: Any, names: Any) -> None:
        for value, name in zip(values, names, strict=True):
            value.name = name


class _Target(type(cpu_target.target_context)):  # type: ignore[misc]
    """numba's translation to LLVM's language, with sizes asked for once and elements of plain arrays made simple.

    For the size of a variable's type, which only debuggers want, numba has LLVM read a program.
    """

    sizes: dict[str, int] = {}  # noqa: RUF012
    cached_internal_func: dict[Any, Any] = {}  # noqa: RUF012
    call_conv = property(CPUCallConv)

    def get_arg_packer(self, fe_args: Any) -> Any:
        return _Whole(self.data_model_manager, fe_args)

    def get_abi_sizeof(self, ty: Any) -> int:
        name = str(ty)
        if name not in self.sizes:
            self.sizes[name] = super().get_abi_sizeof(ty)
        return self.sizes[name]

    def get_function(self, fn: Any, sig: Any, _firstcall: bool = True) -> Any:
        array = sig.args[0] if sig.args else None
        if isinstance(array, types.Array):
            if fn in ("__array__", "static_getitem", "static_setitem"):  # there are none; numba searches all its tables
                raise NotImplementedError
            at_element = _AT_ELEMENT.get(getattr(fn, "typing_key", None))
            index = types.intp if array.ndim == 1 else types.UniTuple(types.intp, array.ndim)
            number = array.layout == "C" and array.dtype in (types.float64, types.int64)
            if at_element is not None and number and sig.args[1] == index:
                return partial(at_element, self, sig)
        return super().get_function(fn, sig, _firstcall)


def element(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Pointer to the element of an array with that number, counted through all axes."""
    data = context.data_model_manager[array_type].get_field_position("data")
    return builder.gep(builder.extract_value(array, data), [index])


def _indexed(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Pointer to array[index], negative ones from the end: what numba makes in several times the instructions."""
    shape = context.data_model_manager[array_type].get_field_position("shape")
    indices = [index] if array_type.ndim == 1 else unpack_tuple(builder, index, array_type.ndim)
    number = None
    for axis, along in enumerate(indices):
        length = builder.extract_value(array, [shape, axis])
        negative = builder.icmp_signed("<", along, along.type(0))
        along = builder.select(negative, builder.add(along, length), along)
        number = along if number is None else builder.add(builder.mul(number, length), along)
    return element(context, builder, array_type, array, number)


def _get(context: Any, signature: Any, builder: Any, args: Any) -> Any:
    return builder.load(_indexed(context, builder, signature.args[0], *args))


def _set(context: Any, signature: Any, builder: Any, args: Any) -> Any:
    array, index, value = args
    value = context.cast(builder, value, signature.args[2], signature.args[0].dtype)
    builder.store(value, _indexed(context, builder, signature.args[0], array, index))
    return context.get_dummy_value()


_AT_ELEMENT: dict[Any, Any] = {operator.getitem: _get, operator.setitem: _set}

for _type in (_PartType, _Known):
    register_model(_type)(models.OpaqueModel)


def _in_order(self: PostProcessor, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """Blocks in order, without the lives of variables, which only generators and reference counts want."""
    self.func_ir.blocks = canonicalize_cfg(self.func_ir.blocks)


#: what takes the place of numba's own meanwhile, among it text for logs that is put together though nobody listens
_BRIEF: list[tuple[Any, str, Any]] = [
    (PostProcessor, "run", _in_order),
    (FunctionIR, "dump_to_string", lambda _: ""),
    (interpreter, "peep_hole_delete_with_exit", lambda func_ir: func_ir),  # of `with` blocks
    *((module, "pformat", id) for module in (ssa, compiler_machinery) if hasattr(module, "pformat")),
]


@contextmanager
def _briefly() -> Iterator[None]:
    """numba without what nobody reads of a kernel's compilation; who else compiles waits, and sees nothing of it."""
    with global_compiler_lock, ExitStack() as undo:
        if gc.isenabled():
            gc.disable()  # of what a compilation makes next to nothing can be freed before its end
            undo.callback(gc.enable)
        for owner, name, brief in _BRIEF:
            undo.callback(setattr, owner, name, getattr(owner, name))
            setattr(owner, name, brief)
        yield


class _KernelCompiler(CompilerBase):
    library = _KernelLibrary

    def __init__(self, typingctx: Any, targetctx: Any, *rest: Any) -> None:
        super().__init__(typingctx, targetctx, *rest)
        target, typing = self.state.targetctx, copy.copy(typingctx)  # of this compilation alone
        target.__class__, typing.__class__ = _Target, _Typing
        self.state.typingctx = target.typing_context = typing
        target.cached_internal_func = _Target.cached_internal_func

    def define_pipelines(self) -> list[Any]:
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        passes = DefaultPassBuilder.define_nopython_pipeline(state)
        passes.passes = [one for one in passes.passes if one[0].name() not in _NEEDLESS]
        self.extend(passes)
        passes.finalize()
        passes._ENFORCING = False  # no checks of numba's own passes
        return [passes]

    def compile_extra(self, func: Any) -> Any:
        with _briefly():
            return super().compile_extra(func)

    def extend(self, passes: Any) -> None:
        """Add to numba's passes."""


class _PartCompiler(_KernelCompiler):
    library = _PartLibrary

    def extend(self, passes: Any) -> None:
        self.state.flags.no_compile = True
        passes.add_pass_after(_Offer, NativeLowering)


@register_pass(mutates_CFG=False, analysis_only=False)
class _Offer(LoweringPass):
    """Make a part known to its callers, as numba does with functions that it has turned into machine code."""

    _name = "offer_part"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        lowered = state.cr
        names = (lowered.fndesc.lookup_module(), lowered.fndesc.qualname, "")
        entry = _dynfunc.make_function(*names, 0, lowered.env, (state.library,))  # never called
        state.targetctx.insert_user_function(entry, lowered.fndesc, [state.library])
        state.cr = lowered._replace(cfunc=entry)
        return True


# -- keeping --------------------------------------------------------------------------------------------------


def _depends_on() -> str:
    """A hash of all that the machine code of kernels depends on."""
    root = Path(__file__).parent.parent
    sources = [(str(path.relative_to(root)), path.read_bytes()) for path in sorted(root.rglob("*.py"))]
    versions = (numba.__version__, llvmlite.__version__, np.__version__, sys.implementation.cache_tag)
    processor = cpu_target.target_context.codegen().magic_tuple()
    return hashlib.sha256(repr((sources, versions, processor)).encode()).hexdigest()[:32]


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
    return path


def _forget_oldest(directory: Path) -> None:
    """Leave the newest of the directories of kernels; one in use that goes is made again."""
    with suppress(OSError):
        for old in sorted(directory.iterdir(), key=lambda one: one.stat().st_mtime)[:-KEPT]:
            shutil.rmtree(old, ignore_errors=True)


class _Kept(_Cache):
    """The machine code of one kernel on disk, a file for each signature; numba's own cache cannot wait for others."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._lock: IO[bytes] | None = None

    @property
    def cache_path(self) -> str:
        return str(kept_in())

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The compiled kernel; None where the caller is to compile it, and has the lock for that."""
        path = self._path(signature)
        if path is None:
            return None
        target_context.refresh()
        code = _read(path)
        if code is None:
            self._lock = _lock(path)
            code = _read(path)
            if code is None:
                return None
            self._release()
        return CompileResult._rebuild(target_context, *pickle.loads(code))

    def save_overload(self, signature: Any, result: Any) -> None:
        path = self._path(signature)
        if path is not None:
            code = dumps(result._reduce())
            with suppress(OSError):
                write_whole(path, hashlib.sha256(code).digest(), code)
        self._release()

    def _path(self, signature: Any) -> Path | None:
        directory = kept_in()
        if directory is None:
            return None
        types_taken = hashlib.sha256(repr(signature).encode()).hexdigest()[:16]
        return directory / f"{self._name}-{types_taken}.code"

    def _release(self) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def enable(self) -> None:
        """Always."""

    def disable(self) -> None:
        """Never."""

    def flush(self) -> None:
        """Forget nothing: what is kept is never stale."""


def _read(path: Path) -> bytes | None:
    """What was written to a file; None if it is not there or not what was written."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    size = hashlib.sha256().digest_size
    return content[size:] if hashlib.sha256(content[size:]).digest() == content[:size] else None


def _lock(path: Path) -> IO[bytes] | None:
    """The lock on a kernel's file, which goes with its process; None where there are no locks, or not in time."""
    end = time.monotonic() + PATIENCE
    try:
        file = path.with_suffix(".lock").open("ab")
    except OSError:
        return None
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except BlockingIOError:
            if time.monotonic() < end:
                time.sleep(0.02)
                continue
        except OSError:
            pass
        file.close()
        return None
