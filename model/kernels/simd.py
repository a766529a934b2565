"""Vector instructions that the compiler does not generate by itself: broadcasts, and sums over lanes.

Each function is written twice: as the loops that define it, and as the instructions that replace them in kernels. The
compiler unrolls a loop of eight before it could become a vector, and reduces a sum over lanes for each quantity alone;
reducing eight quantities at a time takes a third of the instructions.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.extending import intrinsic, overload

from model.kernels.layout import LANES, STATE

Array = Any
_DOUBLE = ir.DoubleType()
_LANES = ir.VectorType(_DOUBLE, LANES)


def broadcast(w: Array, at: int, value: float) -> None:
    """Set quantity `at` of the work array to `value` in all lanes."""
    for i in range(LANES):
        w[at * LANES + i] = value


def horizontal_sum(weights: Array, s: int, lanes: Array, j: int, x: Array, update: Array) -> None:
    """Set row j of x (.., 16) to lane 0 of row j of lanes (.., 128) plus its weighted sum by row s of weights.

    update (2, 16) keeps the largest absolute value of these sums, and their total, which a NaN always reaches.
    """
    for c in range(STATE):
        total = 0.0
        for i in range(LANES):
            total += weights[s, i] * lanes[j, c * LANES + i]
        x[j, c] = lanes[j, c * LANES] + total
        update[0, c] = max(update[0, c], abs(total))
        update[1, c] += abs(total)


def horizontal_sum_slopes(weights: Array, s: int, lanes: Array, j: int, x: Array, to: int, update: Array) -> None:
    """Set row `to` of x likewise for derivatives of strains and velocities; update[1] adds up the results."""
    for c in range(STATE - 4):
        total = 0.0
        for i in range(LANES):
            total += weights[s, i] * lanes[j, c * LANES + i]
        x[to, c] = lanes[j, c * LANES] + total
        update[1, c] += x[to, c]


def _at(context: Any, builder: Any, kind: Any, array: Any, row: Any, width: int, offset: int, count: int) -> Any:
    """Pointer to `count` numbers in a row, `offset` into row `row`, of an array whose rows are `width` long."""
    data = context.make_array(kind)(context, builder, array).data
    index = builder.add(builder.mul(row, ir.Constant(row.type, width)), ir.Constant(row.type, offset))
    return builder.bitcast(builder.gep(data, [index]), ir.VectorType(_DOUBLE, count).as_pointer())


def _pairs(builder: Any, a: Any, b: Any, stride: int) -> tuple[Any, Any]:
    """Of each group of 2 `stride` lanes, the first half of a and of b, and the second half of both."""
    low = [i + half for i in range(0, LANES, 2 * stride) for half in (*range(stride), *range(LANES, LANES + stride))]
    kind = ir.VectorType(ir.IntType(32), LANES)
    return (
        builder.shuffle_vector(a, b, ir.Constant(kind, low)),
        builder.shuffle_vector(a, b, ir.Constant(kind, [i + stride for i in low])),
    )


def _first_and_sum(builder: Any, weights: Any, rows: list[Any]) -> tuple[Any, Any]:
    """Lane 0 of each row, and the sum of its lanes by the weights: two vectors, of a number for each row."""
    firsts, sums, stride = rows, [builder.fmul(weights, row, flags=("contract",)) for row in rows], 1
    while len(sums) > 1:
        firsts = [_pairs(builder, a, b, stride)[0] for a, b in zip(firsts[::2], firsts[1::2], strict=True)]
        sums = [builder.fadd(*_pairs(builder, a, b, stride)) for a, b in zip(sums[::2], sums[1::2], strict=True)]
        stride *= 2
    first, total = firsts[0], sums[0]
    if stride < LANES:
        half = [ir.Constant(ir.VectorType(ir.IntType(32), stride), [*range(k, k + stride)]) for k in (0, stride)]
        first = builder.shuffle_vector(first, first, half[0])
        total = builder.fadd(*(builder.shuffle_vector(total, total, part) for part in half))
    return first, total


def _sums(context: Any, builder: Any, kinds: Any, values: Any, first: int, count: int) -> tuple[Any, Any]:
    """The same for quantities `first` and after; kinds and values are those of weights, s, lanes and j."""
    weights = builder.load(_at(context, builder, kinds[0], values[0], values[1], LANES, 0, LANES), align=8)
    places = [(first + c) * LANES for c in range(count)]
    rows = [_at(context, builder, kinds[2], values[2], values[3], STATE * LANES, place, LANES) for place in places]
    return _first_and_sum(builder, weights, [builder.load(row, align=8) for row in rows])


def _emit_broadcast(context: Any, w: Any, at: Any, value: Any) -> Any:
    def instructions(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = _at(context, builder, signature.args[0], values[0], values[1], LANES, 0, LANES)
        alone = builder.insert_element(ir.Constant(_LANES, ir.Undefined), values[2], ir.Constant(ir.IntType(32), 0))
        spread = builder.shuffle_vector(alone, alone, ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES))
        builder.store(spread, place, align=8)
        return context.get_dummy_value()

    return types.void(w, types.intp, types.float64), instructions


def _emit_horizontal_sum(context: Any, weights: Any, s: Any, lanes: Any, j: Any, x: Any, update: Any) -> Any:
    def instructions(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kinds = signature.args
        size = builder.module.declare_intrinsic(f"llvm.fabs.v{LANES}f64", (), ir.FunctionType(_LANES, [_LANES]))
        for c in range(0, STATE, LANES):
            first, total = _sums(context, builder, kinds, values, c, LANES)
            place = _at(context, builder, kinds[4], values[4], values[3], STATE, c, LANES)
            builder.store(builder.fadd(first, total), place, align=8)
            change = builder.call(size, [total])
            largest, whole = (
                _at(context, builder, kinds[5], values[5], ir.Constant(ir.IntType(64), k), STATE, c, LANES)
                for k in (0, 1)
            )
            before = builder.load(largest, align=8)
            higher = builder.select(builder.fcmp_ordered(">", change, before), change, before)
            builder.store(higher, largest, align=8)
            builder.store(builder.fadd(builder.load(whole, align=8), change), whole, align=8)
        return context.get_dummy_value()

    return types.void(weights, types.intp, lanes, types.intp, x, update), instructions


def _emit_horizontal_sum_slopes(
    context: Any, weights: Any, s: Any, lanes: Any, j: Any, x: Any, to: Any, update: Any
) -> Any:
    def instructions(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        kinds = signature.args
        for c, count in ((0, LANES), (LANES, STATE - 4 - LANES)):
            first, total = _sums(context, builder, kinds, values, c, count)
            here = builder.fadd(first, total)
            place = _at(context, builder, kinds[4], values[4], values[5], STATE, c, count)
            builder.store(here, place, align=8)
            whole = _at(context, builder, kinds[6], values[6], ir.Constant(ir.IntType(64), 1), STATE, c, count)
            builder.store(builder.fadd(builder.load(whole, align=8), here), whole, align=8)
        return context.get_dummy_value()

    return types.void(weights, types.intp, lanes, types.intp, x, types.intp, update), instructions


_broadcast: Any = intrinsic(_emit_broadcast)
_horizontal_sum: Any = intrinsic(_emit_horizontal_sum)
_horizontal_sum_slopes: Any = intrinsic(_emit_horizontal_sum_slopes)

# Kernels take these instructions in the place of the loops.
overload(broadcast)(lambda w, at, value: lambda w, at, value: _broadcast(w, at, value))
overload(horizontal_sum)(
    lambda weights, s, lanes, j, x, update: (
        lambda weights, s, lanes, j, x, update: _horizontal_sum(weights, s, lanes, j, x, update)
    )
)
overload(horizontal_sum_slopes)(
    lambda weights, s, lanes, j, x, to, update: (
        lambda weights, s, lanes, j, x, to, update: _horizontal_sum_slopes(weights, s, lanes, j, x, to, update)
    )
)
