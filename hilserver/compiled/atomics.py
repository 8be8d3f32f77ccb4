"""Atomic loads, stores and fences for kernels that share memory with other threads and processes.

A plain store may be moved by the compiler (and, on ARM, by the processor): the sequence number of a
frame could then announce data that is not written yet. These intrinsics emit LLVM's atomic
instructions on elements of int64 arrays.
"""

from typing import Any

from numba.core import cgutils, types
from numba.extending import intrinsic


def _element(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    array_type, array, index = signature.args[0], args[0], args[1]
    struct = context.make_array(array_type)(context, builder, array)
    return cgutils.get_item_pointer(
        context, builder, array_type, struct, [index], wraparound=False
    )


@intrinsic  # type: ignore[untyped-decorator]
def load_acquire(typing_context: Any, array: Any, index: Any) -> Any:
    """Return ``array[index]`` (int64); nothing after it is moved before it."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load_atomic(
            _element(context, builder, signature, args), "acquire", 8
        )

    return types.int64(array, types.intp), generate


@intrinsic  # type: ignore[untyped-decorator]
def store_release(typing_context: Any, array: Any, index: Any, value: Any) -> Any:
    """Set ``array[index] = value`` (int64); nothing before it is moved after it."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = _element(context, builder, signature, args)
        builder.store_atomic(args[2], pointer, "release", 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def fence(typing_context: Any) -> Any:
    """Order all loads and stores before it against all after it."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), generate
