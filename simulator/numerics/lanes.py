"""Vector registers in compiled code: one shot in each lane.

LLVM vectorises loops only where it may reorder sums, and then the last digits depend on how many numbers
it took together. Here the width is written down and every operation acts on each lane by itself, rounded
as IEEE 754 says: a lane holds the same digits whatever the others hold and however many there are.

In code compiled by numba: ``load(array, start, width)`` with a constant width, `store`, the operators
``+ - * /`` (a number may stand on either side), and the functions below. Nothing here runs outside of it.
numba keeps machine code until the file of the compiled function changes; it does not look at this one.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils as numba_cgutils
from numba.core.typing import templates as numba_templates
from numba.extending import intrinsic as numba_intrinsic
from numba.extending import lower_builtin as numba_lower_builtin
from numba.extending import models as numba_models
from numba.extending import register_model as numba_register_model

# numba's functions carry no types.
cgutils: Any = numba_cgutils
templates: Any = numba_templates
lower_builtin: Any = numba_lower_builtin
models: Any = numba_models
register_model: Any = numba_register_model


class Lanes(types.Type):
    """Vector type of float64 for numba."""

    def __init__(self, width: int) -> None:
        """Create the type of a vector of ``width`` float64 numbers."""
        self.width = width
        super().__init__(name=f"Lanes({width})")


class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        """Represent the type in machine code as an LLVM vector."""
        super().__init__(manager, lanes, _vector_type(lanes))


register_model(Lanes)(_LanesModel)


def _vector_type(lanes: Lanes) -> ir.VectorType:
    """Return the LLVM type of a vector of ``lanes.width`` doubles."""
    return ir.VectorType(ir.DoubleType(), lanes.width)


def _make_intrinsic(function: Callable[..., Any]) -> Callable[..., Any]:
    """Turn a typing function into a Numba intrinsic that prefers literal arguments."""
    intrinsic: Callable[..., Any] = numba_intrinsic(prefer_literal=True)(function)
    return intrinsic


def _emit_lane_address(
    context: Any, builder: Any, array_type: Any, array: Any, start: Any, lanes: Lanes
) -> Any:
    """Emit the address of the lanes that begin at index ``start`` in an array, without a bounds check."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(cgutils.gep_inbounds(builder, data, start), _vector_type(lanes).as_pointer())


@_make_intrinsic
def load(typing: Any, array: Any, start: Any, width: Any) -> Any:
    """Load a vector of `width` (constant) numbers from a contiguous float64 array, from index `start` on."""
    lanes = Lanes(width.literal_value)

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        """Emit the load of the lanes."""
        pointer = _emit_lane_address(context, builder, array, values[0], values[1], lanes)
        return builder.load(pointer, align=8)

    return lanes(array, types.intp, width), codegen


@_make_intrinsic
def store(typing: Any, array: Any, start: Any, lanes: Any) -> Any:
    """Store all lanes of a vector in a contiguous array, from index `start` on."""

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        """Emit the store of the lanes."""
        builder.store(
            values[2], _emit_lane_address(context, builder, array, values[0], values[1], lanes), align=8
        )
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), codegen


@_make_intrinsic
def broadcast(typing: Any, number: Any, width: Any) -> Any:
    """Build a vector of `width` lanes, each holding the same number; the width is a constant."""
    lanes = Lanes(width.literal_value)

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        """Emit the copies of the number."""
        return _emit_broadcast(builder, values[0], lanes)

    return lanes(types.float64, width), codegen


def _emit_broadcast(builder: Any, number: Any, lanes: Lanes) -> Any:
    """Emit a vector with the number in each lane (an LLVM shuffle)."""
    vector = builder.insert_element(ir.Constant(_vector_type(lanes), ir.Undefined), number, ir.IntType(32)(0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), lanes.width), [0] * lanes.width)
    return builder.shuffle_vector(vector, ir.Constant(_vector_type(lanes), ir.Undefined), mask)


def _find_common_vector_type(given: Sequence[Any]) -> Lanes | None:
    """Return the common vector type of the arguments; None if there is none or they differ."""
    lanes = [one for one in given if isinstance(one, Lanes)]
    return lanes[0] if lanes and all(one == lanes[0] for one in lanes) else None


def _make_lane_intrinsic(operands: int, emit: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Create an intrinsic of one to four vectors or numbers, at least one a vector; numbers are broadcast."""

    def infer_type(*given: Any) -> Any:
        """Return signature and code generator for the given types; None if they do not match."""
        lanes = _find_common_vector_type(given)
        if lanes is None:
            return None
        arguments = [one if isinstance(one, Lanes) else types.float64 for one in given]

        def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            """Broadcast numbers to vectors and emit the operation."""
            wide = [
                value if isinstance(one, Lanes) else _emit_broadcast(builder, value, lanes)
                for one, value in zip(arguments, values, strict=True)
            ]
            return emit(builder, wide)

        return lanes(*arguments), codegen

    # numba reads the number of arguments off the function.
    if operands == 1:
        return _make_intrinsic(lambda typing, a: infer_type(a))
    if operands == 2:
        return _make_intrinsic(lambda typing, a, b: infer_type(a, b))
    if operands == 3:
        return _make_intrinsic(lambda typing, a, b, c: infer_type(a, b, c))
    return _make_intrinsic(lambda typing, a, b, c, d: infer_type(a, b, c, d))


def _make_call_emitter(name: str) -> Callable[[Any, Any], Any]:
    """Return a function that emits the call of an LLVM vector function, such as ``llvm.fma``."""

    def emit(builder: Any, values: Any) -> Any:
        """Declare the vector function for these operands and emit its call."""
        kind = values[0].type
        function_type = ir.FunctionType(kind, [kind] * len(values))
        full_name = f"{name}.v{kind.count}f64"
        return builder.call(cgutils.get_or_insert_function(builder.module, function_type, full_name), values)

    return emit


fma = _make_lane_intrinsic(3, _make_call_emitter("llvm.fma"))
"""``a b + c``, rounded once."""
sqrt = _make_lane_intrinsic(1, _make_call_emitter("llvm.sqrt"))
absolute = _make_lane_intrinsic(1, _make_call_emitter("llvm.fabs"))


def _emit_positive(builder: Any, values: Any) -> Any:
    """Emit max(x, 0) of each lane; NaN gives 0."""
    zero = ir.Constant(values[0].type, [0.0] * values[0].type.count)
    return builder.select(builder.fcmp_ordered(">", values[0], zero), values[0], zero)


def _emit_where_greater(builder: Any, values: Any) -> Any:
    """Emit ``c if a > b else d`` for each lane; NaN gives d."""
    return builder.select(builder.fcmp_ordered(">", values[0], values[1]), values[2], values[3])


def _emit_unless_within(builder: Any, values: Any) -> Any:
    """Emit ``d if a <= b else c`` for each lane; NaN gives c."""
    return builder.select(builder.fcmp_unordered(">", values[0], values[1]), values[2], values[3])


positive = _make_lane_intrinsic(1, _emit_positive)
"""``max(a, 0)``; 0 for what is not a number."""
where_greater = _make_lane_intrinsic(4, _emit_where_greater)
"""c in the lanes with a > b, d in the others."""
unless_within = _make_lane_intrinsic(4, _emit_unless_within)
"""d in the lanes with a <= b, c in the others, also where one of them is not a number."""


@_make_intrinsic
def all_positive(typing: Any, lanes: Any) -> Any:
    """Return whether every lane of a vector is greater than zero; NaN is not."""

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        """Emit the comparison of all lanes with zero."""
        zero = ir.Constant(values[0].type, [0.0] * lanes.width)
        above = builder.fcmp_ordered(">", values[0], zero)
        bits = builder.bitcast(above, ir.IntType(lanes.width))
        return builder.icmp_unsigned("==", bits, ir.Constant(bits.type, -1))

    return types.boolean(lanes), codegen


@_make_intrinsic
def lane(typing: Any, lanes: Any, index: Any) -> Any:
    """Return one lane of a vector as a number; its index is a constant."""

    def codegen(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        """Emit the extraction of the lane."""
        return builder.extract_element(values[0], ir.IntType(32)(index.literal_value))

    return types.float64(lanes, index), codegen


def _register_operator(symbol: Any, method: str) -> None:
    """Register an arithmetic operator for vectors, with a vector or number on the other side."""

    class _Template(templates.AbstractTemplate):  # type: ignore[misc]
        def generic(self, arguments: Any, keywords: Any) -> Any:
            """Return the signature for the given types; None if there is no vector or they do not match."""
            lanes = _find_common_vector_type(arguments)
            if lanes is None:
                return None
            return templates.signature(
                lanes, *(one if isinstance(one, Lanes) else types.float64 for one in arguments)
            )

    templates.infer_global(symbol)(_Template)

    def lowered(context: Any, builder: Any, intrinsic: Any, values: Any) -> Any:
        """Broadcast numbers to vectors and emit the operator's instruction."""
        wide = [
            value if isinstance(one, Lanes) else _emit_broadcast(builder, value, intrinsic.return_type)
            for one, value in zip(intrinsic.args, values, strict=True)
        ]
        return getattr(builder, method)(*wide)

    for pair in ((Lanes, Lanes), (Lanes, types.Float), (types.Float, Lanes)):
        lower_builtin(symbol, *pair)(lowered)


_register_operator(operator.add, "fadd")
_register_operator(operator.sub, "fsub")
_register_operator(operator.mul, "fmul")
_register_operator(operator.truediv, "fdiv")
