"""Calls into a C library by addresses that are known only at run time.

An address is a plain int64 in an array of the caller: the compiled code contains none, so its cache
on disk stays valid from one process to the next. Integers and pointers travel in the same registers
(System V x86-64, AAPCS64), so every argument is an int64.
"""

from typing import Any

import numba
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

_POINTER: Any = numba.types.CPointer(types.int64)
_WORD, _STATUS, _DOUBLE = ir.IntType(64), ir.IntType(32), ir.DoubleType()


@intrinsic  # type: ignore[untyped-decorator]
def call(
    typing_context: Any, address: Any, first: Any, second: Any, third: Any, fourth: Any
) -> Any:
    """Call the C function at `address`; one with fewer parameters ignores the last arguments."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = ir.FunctionType(ir.VoidType(), [_WORD] * 4)
        builder.call(builder.inttoptr(args[0], function.as_pointer()), args[1:])
        return context.get_dummy_value()

    return types.void(*[types.int64] * 5), generate


@intrinsic  # type: ignore[untyped-decorator]
def ask(
    typing_context: Any,
    address: Any,
    a: Any,
    b: Any,
    c: Any,
    d: Any,
    e: Any,
    f: Any,
    x: Any,
    y: Any,
) -> Any:
    """Call the C function at `address`; return its int.

    Integers, pointers and booleans are `a` to `f`, doubles are `x` and `y`, whatever their order in
    the signature: the two kinds use separate registers.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = ir.FunctionType(_STATUS, [_WORD] * 6 + [_DOUBLE] * 2)
        status = builder.call(
            builder.inttoptr(args[0], function.as_pointer()), args[1:]
        )
        return builder.sext(status, _WORD)

    return types.int64(*[types.int64] * 7, types.float64, types.float64), generate


@intrinsic  # type: ignore[untyped-decorator]
def words_at(typing_context: Any, address: Any) -> Any:
    """Return a pointer to int64 for `numba.carray`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], _WORD.as_pointer())

    return _POINTER(types.int64), generate
