"""ROS 2 types as DDS needs them: name and members. The bytes are made by `hilserver.ros`.

``std_msgs/msg/Float32`` is ``std_msgs::msg::dds_::Float32_`` on the wire, final (XCDR1).
"""

from functools import cached_property
from typing import Any, Final

from cyclonedds.idl import annotations, make_idl_struct
from cyclonedds.idl import types as described

from hilserver.ros.types import Types

idl: Any = described  # its generics are created at run time

_BASE: Final[dict[str, Any]] = {
    "bool": bool,
    "byte": idl.uint8,
    "char": idl.uint8,
    "uint8": idl.uint8,
    "int8": idl.int8,
    "uint16": idl.uint16,
    "int16": idl.int16,
    "uint32": idl.uint32,
    "int32": idl.int32,
    "uint64": idl.uint64,
    "int64": idl.int64,
    "float32": idl.float32,
    "float64": idl.float64,
}
EMPTY: Final = {"structure_needs_at_least_one_member": idl.uint8}
IDENTITY: Final = {"guid": idl.uint64, "sequence_number": idl.int64}
"""What rmw_cyclonedds puts before request and response."""


class WireTypes:
    """Makes each type once."""

    def __init__(self, types: Types) -> None:
        self._types = types
        self._members: dict[str, Any] = {}

    @cached_property
    def _kinds(self) -> Any:
        from rosbags.interfaces import Nodetype  # noqa: PLC0415 -- slow to import

        return Nodetype

    def make(self, name: str, *, with_identity: bool = False) -> Any:
        """Return a class whose instances carry the CDR bytes of a sample in ``cdr``."""
        members = {**(IDENTITY if with_identity else {}), **self._fields(name)}
        carrier: Any = _struct(name, members)
        carrier.serialize = _bytes_of
        carrier.deserialize = classmethod(carried)
        carrier.deserialize_key = classmethod(_nothing)
        return carrier

    def _fields(self, name: str) -> dict[str, Any]:
        fields = {field: self._type(kind) for field, kind in self._types.fields(name)}
        return fields or EMPTY

    def _type(self, description: Any) -> Any:
        kind, rest = description
        if kind == self._kinds.NAME:
            if rest not in self._members:
                self._members[rest] = _struct(rest, self._fields(rest))
            return self._members[rest]
        if kind == self._kinds.BASE:
            base, limit = rest
            if base == "string":
                return idl.bounded_str[limit] if limit else str
            return _BASE[base]
        inner, count = rest
        if kind == self._kinds.ARRAY:
            return idl.array[self._type(inner), count]
        return (
            idl.sequence[self._type(inner), count]
            if count
            else idl.sequence[self._type(inner)]
        )


def _struct(name: str, members: dict[str, Any]) -> Any:
    package, kind, short = name.split("/")
    made = make_idl_struct(f"{short}_", f"{package}.{kind}.dds_.{short}_", members)
    return annotations.final(made)


def _bytes_of(sample: Any, **_: Any) -> bytes:
    return bytes(sample.cdr)


def carried(cls: Any, cdr: bytes, /, **_: Any) -> Any:
    """Return a sample of a carrier's class."""
    sample = cls.__new__(cls)
    sample.cdr = cdr
    return sample


def _nothing(_cls: Any, _data: bytes, /, **_: Any) -> None:
    return None
