"""Eight numbers at a time, and the bits of a word, in instructions that numba has no functions for.

Sums are in the order of the numbers, as a loop makes them.
"""

import llvmlite.ir

from vlp16emu.kernels.compiler import NumbaObject, numba

_BIT = llvmlite.ir.IntType(1)
_DOUBLE = llvmlite.ir.DoubleType()
_EIGHT = llvmlite.ir.VectorType(_DOUBLE, 8)
_FLOATS = llvmlite.ir.VectorType(llvmlite.ir.FloatType(), 8)
_INDEX = llvmlite.ir.IntType(32)
_WORDS = llvmlite.ir.VectorType(_INDEX, 8)
_LONG = llvmlite.ir.IntType(64)


@numba.extending.intrinsic
def lowest_bit(typingctx: NumbaObject, word: NumbaObject) -> NumbaObject:
    """Find the lowest bit of a word that is not 0."""

    def codegen(
        context: NumbaObject, builder: NumbaObject, signature: NumbaObject, args: NumbaObject
    ) -> NumbaObject:
        return builder.cttz(args[0], llvmlite.ir.Constant(_BIT, 1))

    return numba.types.uint64(numba.types.uint64), codegen


@numba.extending.intrinsic
def count_bits(typingctx: NumbaObject, word: NumbaObject) -> NumbaObject:
    """Count the bits of a word."""

    def codegen(
        context: NumbaObject, builder: NumbaObject, signature: NumbaObject, args: NumbaObject
    ) -> NumbaObject:
        return builder.ctpop(args[0])

    return numba.types.uint64(numba.types.uint64), codegen


@numba.extending.intrinsic
def weigh_eight(
    typingctx: NumbaObject,
    values: NumbaObject,
    factors: NumbaObject,
    rows: NumbaObject,
    table: NumbaObject,
    least: NumbaObject,
    room: NumbaObject,
) -> NumbaObject:
    """Convert eight values to float64, and fill in their weights: a factor times a number of a table.

    Parameters
    ----------
    values, factors, rows : addresses of eight float32, float32 and uint32
    table : address of float32 by row; its first one is read for values of infinity
    least : added to each weight
    room : address of sixteen float64, for values and weights

    Returns
    -------
    bits of the finite values
    """
    kinds = numba.types

    def codegen(
        context: NumbaObject, builder: NumbaObject, signature: NumbaObject, args: NumbaObject
    ) -> NumbaObject:
        addresses = zip(args[:3], (_FLOATS, _FLOATS, _WORDS), strict=True)
        value, factor, row = (
            builder.load(builder.inttoptr(address, kind.as_pointer()), align=4) for address, kind in addresses
        )
        finite = builder.fcmp_ordered("<", value, llvmlite.ir.Constant(_FLOATS, [float("inf")] * 8))
        row = builder.select(finite, row, llvmlite.ir.Constant(_WORDS, [0] * 8))
        table = builder.inttoptr(args[3], llvmlite.ir.FloatType().as_pointer())
        numbers = llvmlite.ir.Constant(_FLOATS, llvmlite.ir.Undefined)
        for lane in range(8):
            at = builder.zext(builder.extract_element(row, _INDEX(lane)), _LONG)
            numbers = builder.insert_element(numbers, builder.load(builder.gep(table, [at])), _INDEX(lane))
        weight = builder.fmul(builder.fpext(numbers, _EIGHT), builder.fpext(factor, _EIGHT))
        weight = builder.fadd(weight, _splat(builder, args[4]))
        room = builder.inttoptr(args[5], _EIGHT.as_pointer())
        builder.store(builder.fpext(value, _EIGHT), room, align=8)
        builder.store(weight, builder.gep(room, [_LONG(1)]), align=8)
        return builder.zext(builder.bitcast(finite, llvmlite.ir.IntType(8)), _LONG)

    words = [kinds.uint64] * 4
    return kinds.uint64(*words, kinds.float64, kinds.uint64), codegen


@numba.extending.intrinsic
def sum_near(
    typingctx: NumbaObject, room: NumbaObject, left: NumbaObject, middle: NumbaObject, reach: NumbaObject
) -> NumbaObject:
    """Sum the weights of values near one of them, as from `weigh_eight`.

    Parameters
    ----------
    room : as there
    left : bits of the values that count
    middle, reach : value, and greatest difference from it

    Returns
    -------
    bits of the values that are not near, the sum of weights, and that of their products with the differences
    """
    kinds = numba.types
    double = kinds.float64

    def codegen(
        context: NumbaObject, builder: NumbaObject, signature: NumbaObject, args: NumbaObject
    ) -> NumbaObject:
        room = builder.inttoptr(args[0], _EIGHT.as_pointer())
        counts = builder.bitcast(
            builder.trunc(args[1], llvmlite.ir.IntType(8)), llvmlite.ir.VectorType(_BIT, 8)
        )
        away = builder.fsub(builder.load(room, align=8), _splat(builder, args[2]))
        size = _call(builder, "llvm.fabs.v8f64", _EIGHT, away)
        near = builder.and_(builder.fcmp_ordered("<=", size, _splat(builder, args[3])), counts)
        none = llvmlite.ir.Constant(_EIGHT, [0.0] * 8)
        weight = builder.select(near, builder.load(builder.gep(room, [_LONG(1)]), align=8), none)
        product = builder.select(near, builder.fmul(weight, away), none)  # 0 times infinity is no number
        zero = llvmlite.ir.Constant(_DOUBLE, 0.0)
        total, moment = (
            _call(builder, "llvm.vector.reduce.fadd.v8f64", _DOUBLE, zero, terms)
            for terms in (weight, product)
        )
        word = builder.zext(builder.bitcast(near, llvmlite.ir.IntType(8)), _LONG)
        rest = builder.and_(args[1], builder.not_(word))
        return context.make_tuple(builder, signature.return_type, [rest, total, moment])

    result = kinds.Tuple([kinds.uint64, double, double])
    return result(kinds.uint64, kinds.uint64, double, double), codegen


def _splat(builder: NumbaObject, number: NumbaObject) -> NumbaObject:
    """Return eight times a number."""
    empty = llvmlite.ir.Constant(_EIGHT, llvmlite.ir.Undefined)
    one = builder.insert_element(empty, number, _INDEX(0))
    return builder.shuffle_vector(one, empty, llvmlite.ir.Constant(_WORDS, [0] * 8))


def _call(builder: NumbaObject, name: str, kind: NumbaObject, *numbers: NumbaObject) -> NumbaObject:
    """Call a function of LLVM that returns a value of a kind."""
    signature = llvmlite.ir.FunctionType(kind, [number.type for number in numbers])
    function = numba.core.cgutils.get_or_insert_function(builder.module, signature, name)
    return builder.call(function, numbers)
