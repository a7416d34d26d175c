"""What storing g in float32 would gain in time: the kernels as they are, with loads that widen and stores that round.

    .venv/bin/python benchmarks/float32_bound.py [--cells 40 40] [--velocity 24 24 8] [--rounds 12]

The loads and stores of `simd.py` are replaced, in this process alone, by some that look at an array's type; both
stages are then timed in turn for g in double and in single precision, ghosts not exchanged. Times are those of the
processor, which other work on the machine disturbs less than the clock. Compiles for some minutes: nothing of this may
go to the cache.
"""

import argparse
import math
import tempfile
import time

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from rvm_mpi.compiling import simd

SINGLES = ir.VectorType(ir.FloatType(), simd.LANES)


def _place(context, builder, array_type, array, index):
    """Address of eight numbers of an array and their alignment, and whether they are single."""
    pointer = simd._address(context, builder, array_type, array, index)
    if array_type.dtype == types.float32:
        return builder.bitcast(pointer, SINGLES.as_pointer()), 4, True
    return pointer, 8, False


@intrinsic
def load(typingctx, array, index):
    """`simd.load` of an array of either precision."""

    def codegen(context, builder, signature, args):
        pointer, align, single = _place(context, builder, signature.args[0], *args)
        value = builder.load(pointer, align=align)
        return builder.fpext(value, simd._VECTOR) if single else value

    return simd.vector8(array, types.intp), codegen


@intrinsic
def store(typingctx, array, index, value):
    """`simd.store` to an array of either precision."""

    def codegen(context, builder, signature, args):
        pointer, align, single = _place(context, builder, signature.args[0], *args[:2])
        builder.store(builder.fptrunc(args[2], SINGLES) if single else args[2], pointer, align=align)
        return context.get_dummy_value()

    return types.void(array, types.intp, simd.vector8), codegen


JOB = {
    "collision": {"operator": "granular-es-bgk", "knudsen": 0.01, "restitution": 0.99},
    "fluid": {"enabled": True},
    "initial": {"state": "random-density", "low": 0.2},
    "time": {"end": 1e3},
}


def in_single(double, guard):
    """An array's numbers in single precision, with `guard` numbers of room before and after."""
    from rvm_mpi.grid.domain import aligned

    room = aligned((double.size + guard,)).view(np.float32)[guard // 2 :]
    array = room[: double.size].reshape(double.shape)
    array[...] = double
    return array


def stepper(cells, velocity, single):
    """The kinetic part of a simulation after a step, g in the precision wanted, and a step's length."""
    from rvm_mpi import Job, Simulation

    sim = Simulation(Job.from_dict({"space": {"cells": cells}, "velocity": {"points": velocity}, **JOB}))
    kinetic = sim.kinetic
    sim.advance()
    if single:
        kinetic.g, kinetic._others[0] = (
            in_single(array, 8 * kinetic.grid.block) for array in (kinetic.g, kinetic._others[0])
        )
    return kinetic, 0.5 * sim.last_dt


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--cells", type=int, nargs=2, default=[40, 40])
    parser.add_argument("--velocity", type=int, nargs=3, default=[24, 24, 8])
    parser.add_argument("--rounds", type=int, default=12)
    arguments = parser.parse_args()
    simd.load, simd.store = load, store  # before the kernels are imported, which take what simd has then
    with tempfile.TemporaryDirectory() as cache:
        numba.config.CACHE_DIR = cache
        measure(arguments)


def measure(arguments):
    from rvm_mpi.compiling.declare import kernel
    from rvm_mpi.grid.domain import Domain
    from rvm_mpi.step import stepper as stepping

    # each precision has a kernel of its own: one for both takes the arrays of one for those of the other
    sweeps = {"float64": stepping.sweep, "float32": kernel(stepping.sweep.function)}
    runs = {name: stepper(arguments.cells, arguments.velocity, name == "float32") for name in ("float64", "float32")}
    Domain.exchange = lambda *_: None
    least = dict.fromkeys(runs, math.inf)
    for turn in range(arguments.rounds + 1):
        for name, (kinetic, dt) in runs.items():
            stepping.sweep = sweeps[name]
            begin = time.process_time()
            kinetic.first_stage(dt)
            kinetic.later_stages(dt)
            if turn:  # the first compiles
                least[name] = min(least[name], time.process_time() - begin)
    nodes = 2 * math.prod(arguments.cells) * math.prod(arguments.velocity)
    figures = ", ".join(f"{name} {1e9 * seconds / nodes:.2f} ns" for name, seconds in least.items())
    print(f"a phase-space cell and stage: {figures}; gain {least['float64'] / least['float32']:.2f}")


if __name__ == "__main__":
    main()
