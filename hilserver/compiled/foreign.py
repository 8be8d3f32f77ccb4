"""Calls into a C library by addresses that are known at run time only.

An address is a plain int64 in an array of the caller: the compiled code holds none, so its cache on
disk stays valid from one process to the next. Integers and pointers travel in the same registers
(System V x86-64, AAPCS64), so every argument is an int64.
"""

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

_WORD = ir.IntType(64)


@intrinsic  # type: ignore[untyped-decorator]
def call(
    typing_context: Any, address: Any, first: Any, second: Any, third: Any, fourth: Any
) -> Any:
    """Call the C function at `address`; one that takes fewer arguments ignores the last."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = ir.FunctionType(ir.VoidType(), [_WORD] * 4)
        builder.call(builder.inttoptr(args[0], function.as_pointer()), args[1:])
        return context.get_dummy_value()

    return types.void(*[types.int64] * 5), generate
