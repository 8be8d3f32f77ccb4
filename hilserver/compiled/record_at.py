"""A record within a kernel, see `records`."""

from typing import Any

from numba.core import cgutils, types
from numba.extending import intrinsic


@intrinsic  # type: ignore[untyped-decorator]
def record_at(typing_context: Any, array: Any, place: Any, layout: Any) -> Any:
    """Return the record of `layout` whose first word is ``array[place]``; not checked.

    It does not keep the array alive: an array made in a kernel must be used after its record.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        words = context.make_array(signature.args[0])(context, builder, args[0])
        address = builder.gep(words.data, [args[1]])
        return builder.bitcast(address, context.get_value_type(signature.return_type))

    return layout.dtype(array, types.intp, layout), generate


@intrinsic  # type: ignore[untyped-decorator]
def assign(typing_context: Any, target: Any, source: Any) -> Any:
    """Copy all numbers of a record to another of the same layout."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        n_bytes = context.get_constant(types.intp, signature.args[0].size)
        cgutils.raw_memcpy(builder, args[0], args[1], n_bytes, 1)
        return context.get_dummy_value()

    return (types.void(target, source), generate) if target == source else None
