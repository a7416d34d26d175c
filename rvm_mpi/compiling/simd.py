"""A vector of eight doubles for kernels, with loads and stores that LLVM need not guard.

numba's own array indexing handles negative indices, which keeps LLVM from vectorising, and how well it
vectorises the rest differs from one numba version to the next. The kernels of this package therefore say what
they mean: `load(a, i)` is the eight doubles a[i:i+8], arithmetic works on all eight, `store(a, i, v)` puts them
back. On processors with narrower registers LLVM splits the operations.

Every operation rounds as IEEE 754 says, and none is fused, reordered or left out behind the reader's back: `fma` is
where a product is not rounded before the sum. So results depend neither on the processor nor on numba's version.

It stands on what numba documents for extensions: `intrinsic`, and `type_callable` with `lower_builtin` for operators.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

LANES = 8
_DOUBLE = ir.DoubleType()
_VECTOR = ir.VectorType(_DOUBLE, LANES)
_INTS = ir.VectorType(ir.IntType(64), LANES)
_I32 = ir.IntType(32)
_LANE_INDEX = ir.VectorType(_I32, LANES)


class _Vector8(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Vector8")


vector8 = _Vector8()


@register_model(_Vector8)
class _Vector8Model(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _VECTOR)


def _constant(value: float) -> ir.Constant:
    return ir.Constant(_VECTOR, [float(value)] * LANES)


def element(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Pointer to the element of an array with that number, counted through all axes."""
    data = context.data_model_manager[array_type].get_field_position("data")
    return builder.gep(builder.extract_value(array, data), [index])


def _address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    return builder.bitcast(element(context, builder, array_type, array, index), _VECTOR.as_pointer())


def _places(context: Any, builder: Any, kinds: Any, args: Any) -> list[Any]:
    """Addresses of the eight doubles array[index + places[lane]]; args begin with array, index, places."""
    first = element(context, builder, kinds[0], args[0], args[1])
    places = [element(context, builder, kinds[2], args[2], ir.Constant(_I32, lane)) for lane in range(LANES)]
    return [builder.gep(first, [builder.load(place)]) for place in places]


def _call(builder: Any, name: str, *args: Any) -> Any:
    """A function of LLVM's own on vectors (`llvm.name.v8f64`) or, given doubles, on doubles."""
    kind = args[0].type
    suffix = f"v{LANES}f64" if kind == _VECTOR else "f64"
    function = builder.module.declare_intrinsic(f"llvm.{name}.{suffix}", (), ir.FunctionType(kind, [kind] * len(args)))
    return builder.call(function, args)


def _as_vectors(builder: Any, kinds: Any, values: Any) -> list[Any]:
    return [value if kind == vector8 else _splat(builder, value) for kind, value in zip(kinds, values, strict=True)]


def _splat(builder: Any, value: Any) -> Any:
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, value, _I32(0))
    return builder.shuffle_vector(first, undefined, ir.Constant(_LANE_INDEX, [0] * LANES))


@intrinsic
def load(typingctx, array, index):  # type: ignore[no-untyped-def]
    """The eight doubles array[index:index+8]; the caller answers for the bounds."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.load(_address(context, builder, signature.args[0], args[0], args[1]), align=8)

    return vector8(array, types.intp), codegen


@intrinsic
def store(typingctx, array, index, value):  # type: ignore[no-untyped-def]
    """array[index:index+8] = value; the caller answers for the bounds."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        builder.store(args[2], _address(context, builder, signature.args[0], args[0], args[1]), align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector8), codegen


@intrinsic
def prefetch(typingctx, array, index):  # type: ignore[no-untyped-def]
    """Ask for the cache line of array[index]; harmless outside the array."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = element(context, builder, signature.args[0], args[0], args[1])
        pointer = builder.bitcast(pointer, ir.IntType(8).as_pointer())
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, _I32, _I32, _I32])
        # the older of LLVM's names has the pointer's type in it
        name = "llvm.prefetch.p0" if "i8" not in str(pointer.type) else "llvm.prefetch.p0i8"
        function = builder.module.declare_intrinsic(name, (), kind)
        builder.call(function, [pointer, _I32(0), _I32(3), _I32(1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), codegen


@intrinsic
def collect(typingctx, array, index, places):  # type: ignore[no-untyped-def]
    """The eight doubles array[index + places[lane]], counted from the array's first element whatever its strides."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        vector = ir.Constant(_VECTOR, ir.Undefined)
        for lane, pointer in enumerate(_places(context, builder, signature.args, args)):
            vector = builder.insert_element(vector, builder.load(pointer), _I32(lane))
        return vector

    return vector8(array, types.intp, places), codegen


@intrinsic
def distribute(typingctx, array, index, places, vector):  # type: ignore[no-untyped-def]
    """array[index + places[lane]] = the lane's double, the last lane last: `collect` back again."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        for lane, pointer in enumerate(_places(context, builder, signature.args, args)):
            builder.store(builder.extract_element(args[3], _I32(lane)), pointer)
        return context.get_dummy_value()

    return types.void(array, types.intp, places, vector8), codegen


@intrinsic
def splat(typingctx, value):  # type: ignore[no-untyped-def]
    """A vector with `value` in every lane."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return _splat(builder, args[0])

    return vector8(types.float64), codegen


@intrinsic
def spread(typingctx, array, index):  # type: ignore[no-untyped-def]
    """A vector with array[index] in every lane; the caller answers for the bounds."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pointer = element(context, builder, signature.args[0], args[0], args[1])
        return _splat(builder, builder.load(pointer))

    return vector8(array, types.intp), codegen


@intrinsic
def first_lane(typingctx, vector):  # type: ignore[no-untyped-def]
    """The first of the eight doubles."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.extract_element(args[0], _I32(0))

    return types.float64(vector8), codegen


@intrinsic
def leading(typingctx, vector, count):  # type: ignore[no-untyped-def]
    """The first `count` lanes of a vector, zero in the others."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        undefined = ir.Constant(_INTS, ir.Undefined)
        counts = builder.insert_element(undefined, args[1], _I32(0))
        counts = builder.shuffle_vector(counts, undefined, ir.Constant(_LANE_INDEX, [0] * LANES))
        within = builder.icmp_signed("<", ir.Constant(_INTS, list(range(LANES))), counts)
        return builder.select(within, args[0], _constant(0.0))

    return vector8(vector8, types.intp), codegen


@intrinsic
def total(typingctx, vector):  # type: ignore[no-untyped-def]
    """The sum of the lanes, from the first to the last."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        result = builder.extract_element(args[0], _I32(0))
        for lane in range(1, LANES):
            result = builder.fadd(result, builder.extract_element(args[0], _I32(lane)))
        return result

    return types.float64(vector8), codegen


def _binary(emit: Callable[[Any, Any, Any], Any]) -> Any:
    @intrinsic
    def operation(typingctx, a, b):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            return emit(builder, args[0], args[1])

        return vector8(vector8, vector8), codegen

    return operation


def _select(builder: Any, comparison: str, a: Any, b: Any) -> Any:
    return builder.select(builder.fcmp_ordered(comparison, a, b), a, b)


minimum = _binary(lambda builder, a, b: _select(builder, "<", a, b))
maximum = _binary(lambda builder, a, b: _select(builder, ">", a, b))


def _register(python_operator: Any, instruction: str) -> None:
    """a + b and the like of vectors, and of a vector and a number, as one instruction."""

    @type_callable(python_operator)
    def kind(context):  # type: ignore[no-untyped-def]
        def of(a, b):  # type: ignore[no-untyped-def]
            if vector8 in (a, b) and all(one in (vector8, types.float64) for one in (a, b)):
                return vector8
            return None

        return of

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return getattr(builder, instruction)(*_as_vectors(builder, signature.args, args))

    for kinds in ((vector8, vector8), (vector8, types.float64), (types.float64, vector8)):
        lower_builtin(python_operator, *kinds)(codegen)


for _operator, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _register(_operator, _instruction)


def _register_unary(function: Any, name: str) -> None:
    @type_callable(function)
    def kind(context):  # type: ignore[no-untyped-def]
        return lambda a: vector8 if a == vector8 else None

    @lower_builtin(function, vector8)
    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return _call(builder, name, *args)


_register_unary(abs, "fabs")
_register_unary(math.sqrt, "sqrt")


@intrinsic
def fma(typingctx, a, b, c):  # type: ignore[no-untyped-def]
    """a b + c, rounded once: of vectors, of vectors and numbers, or of numbers."""
    kinds = (a, b, c)
    result = vector8 if vector8 in kinds else types.float64

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return _call(builder, "fma", *(_as_vectors(builder, kinds, args) if result == vector8 else args))

    return result(*(kind if kind == vector8 else types.float64 for kind in kinds)), codegen


@intrinsic
def shifted(typingctx, previous, vector):  # type: ignore[no-untyped-def]
    """The lanes of `vector` moved up by one, the last of `previous` first."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        lanes = ir.Constant(_LANE_INDEX, list(range(LANES - 1, 2 * LANES - 1)))
        return builder.shuffle_vector(args[0], args[1], lanes)

    return vector8(vector8, vector8), codegen


def _shuffle(first: list[int], second: list[int]) -> Any:
    @intrinsic
    def operation(typingctx, a, b):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            parts = [
                builder.shuffle_vector(args[0], args[1], ir.Constant(_LANE_INDEX, lanes)) for lanes in (first, second)
            ]
            return context.make_tuple(builder, signature.return_type, parts)

        return types.UniTuple(vector8, 2)(vector8, vector8), codegen

    return operation


_PAIRS = [place for lane in range(LANES) for place in (lane, LANES + lane)]
#: the even and the odd lanes of a and b, one behind the other: real and imaginary parts of eight complex numbers
apart = _shuffle(list(range(0, 2 * LANES, 2)), list(range(1, 2 * LANES, 2)))
#: `apart` back again: a0, b0, a1, b1, ...
together = _shuffle(_PAIRS[:LANES], _PAIRS[LANES:])


@intrinsic
def upwind(typingctx, speed, left, right):  # type: ignore[no-untyped-def]
    """speed * left where speed > 0, else speed * right."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        speed, left, right = args
        from_left = builder.fcmp_ordered(">", speed, _constant(0.0))
        return builder.fmul(speed, builder.select(from_left, left, right))

    return vector8(vector8, vector8, vector8), codegen


@intrinsic
def where_above(typingctx, value, bound, a, b):  # type: ignore[no-untyped-def]
    """a where value > bound, else b."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.select(builder.fcmp_ordered(">", args[0], args[1]), args[2], args[3])

    return vector8(vector8, vector8, vector8, vector8), codegen


@intrinsic
def where_positive(typingctx, condition, a, b):  # type: ignore[no-untyped-def]
    """a where condition > 0, else b."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.select(builder.fcmp_ordered(">", args[0], _constant(0.0)), args[1], args[2])

    return vector8(vector8, vector8, vector8), codegen


@intrinsic
def where_negative(typingctx, sign, a, b):  # type: ignore[no-untyped-def]
    """a where the sign of `sign` is minus (-0 is), else b; cheaper than `where_positive`, which compares."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        minus = builder.icmp_signed("<", builder.bitcast(args[0], _INTS), ir.Constant(_INTS, [0] * LANES))
        return builder.select(minus, args[1], args[2])

    return vector8(vector8, vector8, vector8), codegen


_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 0.693145751953125, 1.42860682030941723212e-6
_ROUND = 6755399441055744.0  # 1.5 * 2^52: adding it rounds to the nearest integer
_ROUND_BITS = 4843621399236968448


@intrinsic
def exponential(typingctx, x):  # type: ignore[no-untyped-def]
    """exp(x) to 1e-14 relative; x is clamped to [-708, 709], so the smallest result is 3e-308."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        x = _select(builder, ">", args[0], _constant(-708.0))
        x = _select(builder, "<", x, _constant(709.0))
        shifted = builder.fadd(builder.fmul(x, _constant(_LOG2_E)), _constant(_ROUND))
        power = builder.fsub(shifted, _constant(_ROUND))
        r = _call(builder, "fma", power, _constant(-_LN2_HIGH), x)
        r = _call(builder, "fma", power, _constant(-_LN2_LOW), r)
        c = [_constant(1.0 / math.factorial(n)) for n in range(12)]
        r2 = builder.fmul(r, r)
        r4 = builder.fmul(r2, r2)
        r8 = builder.fmul(r4, r4)
        pair = [_call(builder, "fma", r, c[n + 1], c[n]) for n in range(0, 12, 2)]
        four = [_call(builder, "fma", r2, pair[n + 1], pair[n]) for n in (0, 2, 4)]
        polynomial = _call(builder, "fma", r8, four[2], _call(builder, "fma", r4, four[1], four[0]))
        offset = ir.Constant(_INTS, [_ROUND_BITS - 1023] * LANES)
        exponent = builder.sub(builder.bitcast(shifted, _INTS), offset)
        scale = builder.shl(exponent, ir.Constant(_INTS, [52] * LANES))
        return builder.fmul(polynomial, builder.bitcast(scale, _VECTOR))

    return vector8(vector8), codegen
