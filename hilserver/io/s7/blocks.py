"""Data blocks: big-endian numbers at their places, read from a frame, written as a group."""

import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from hilserver.config.s7 import FORMS, BlockPlace, S7Server
from hilserver.errors import ConfigError, no_signal
from hilserver.image import Frame
from hilserver.io.s7.wire import Code, Item
from hilserver.signals import Signal, SignalTable, ValueType
from hilserver.status import is_bad

_LARGEST_REAL: Final = struct.unpack(">f", b"\x7f\x7f\xff\xff")[0]
_PACKERS: Final[Mapping[str, struct.Struct]] = {
    name: struct.Struct(">" + form.code) for name, form in FORMS.items()
}
COUNTING: Final = frozenset((ValueType.INT64, ValueType.UINT32))
"""Types of signals that wrap if the controller's type is shorter; others saturate."""


def packed(place: BlockPlace, value: float, *, wraps: bool = False) -> bytes:
    """Return a value in the type of its place, the nearest one that this type has.

    `wraps`: whether a whole number that is too large wraps around.
    """
    packer = _PACKERS[place.type]
    if place.type == "BOOL":
        return packer.pack(bool(value))
    if place.type == "REAL":
        limit = _LARGEST_REAL
        return packer.pack(
            max(-limit, min(limit, value)) if math.isfinite(value) else value
        )
    if place.type == "LREAL":
        return packer.pack(value)
    if not math.isfinite(value):
        return bytes(place.size)
    bits, whole = 8 * place.size, round(value)
    signed = FORMS[place.type].code.islower()
    low, high = (
        (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    )
    if wraps:
        whole = (whole - low) % (1 << bits) + low
    return packer.pack(max(low, min(high, whole)))


def unpacked(place: BlockPlace, data: bytes, start: int = 0) -> bool | int | float:
    """Return the value of a place.

    `start`: byte of the block at which `data` begins.
    """
    if place.type == "BOOL":
        return bool(data[place.byte - start] >> place.bit & 1)
    value: int | float = _PACKERS[place.type].unpack_from(data, place.byte - start)[0]
    return value


def put(block: bytearray, place: BlockPlace, data: bytes, start: int = 0) -> None:
    """Put the result of `packed` into a block; other bits of its byte stay."""
    at = place.byte - start
    if place.type == "BOOL":
        block[at] = block[at] & ~(1 << place.bit) | data[0] << place.bit
    else:
        block[at : at + len(data)] = data


def check_type(signal: Signal, kind: str) -> None:
    """Raise ConfigError if a signal cannot have this type."""
    if (kind == "BOOL") != (signal.type is ValueType.BOOLEAN):
        have = "BOOL" if signal.type is ValueType.BOOLEAN else "a number, as REAL"
        raise ConfigError(f"'{signal.name}' is {have}, not {kind}")


class RefusedItemError(Exception):
    """A piece of a block that cannot be read or written."""

    def __init__(self, code: Code) -> None:
        super().__init__(code.name)
        self.code = code


@dataclass(frozen=True)
class DataBlock:
    """One block."""

    fields: tuple[tuple[BlockPlace, Signal], ...]  # place and signal
    size: int  # bytes

    def filled(self, frame: Frame) -> bytes:
        """Return the block for a frame; a number with status Bad is NaN, or 0 if integer."""
        block = bytearray(self.size)
        for place, signal in self.fields:
            slot = signal.slots[0]
            no_value = is_bad(int(frame.status[slot]))
            value = float("nan") if no_value else float(frame.values[slot])
            if place.type == "BOOL" and no_value:
                value = 0.0
            put(block, place, packed(place, value, wraps=signal.type in COUNTING))
        return bytes(block)

    def read(self, item: Item, content: bytes) -> bytes:
        """Return the bytes of an item; RefusedItemError if the block is shorter."""
        byte, bit = divmod(item.bit, 8)
        if byte + item.size > self.size:
            raise RefusedItemError(Code.BEYOND)
        return (
            bytes((content[byte] >> bit & 1,))
            if item.is_bit
            else content[byte:][: item.size]
        )

    def written(self, item: Item, data: bytes) -> Mapping[str, object]:
        """Return the values that an item writes, by signal.

        RefusedItemError if it covers only a part of a number, no signal, or one that is no input.
        """
        byte = item.bit // 8
        if byte + item.size > self.size:
            raise RefusedItemError(Code.BEYOND)
        if len(data) != item.size:
            raise RefusedItemError(Code.UNFIT)
        hit = item.bits
        values: dict[str, object] = {}
        for place, signal in self._hit(hit):
            if place.bits.start < hit.start or place.bits.stop > hit.stop:
                raise RefusedItemError(Code.UNFIT)
            if not signal.writable:
                raise RefusedItemError(Code.DENIED)
            values[signal.name] = (
                bool(data[0] & 1) if item.is_bit else unpacked(place, data, byte)
            )
        if not values:
            raise RefusedItemError(Code.BEYOND)
        return values

    def touched(self, item: Item) -> set[str]:
        """Return the signals that an item covers, if only in part."""
        return {signal.name for _, signal in self._hit(item.bits)}

    def _hit(self, bits: range) -> Iterator[tuple[BlockPlace, Signal]]:
        for place, signal in self.fields:
            if place.bits.start < bits.stop and place.bits.stop > bits.start:
                yield place, signal


def blocks_of(server: S7Server, table: SignalTable) -> dict[int, DataBlock]:
    """Return the blocks of a configuration by their number.

    ConfigError if there is no such signal, or its type does not fit.
    """
    scalars = {signal.name: signal for signal in table.scalars if not signal.hidden}
    blocks = {}
    for number, layout in server.blocks.items():
        fields = []
        for field in layout:
            signal = scalars.get(field.signal)
            if signal is None:
                raise ConfigError(f"block {number}: {no_signal(field.signal, scalars)}")
            try:
                check_type(signal, field.type)
            except ConfigError as error:
                raise ConfigError(f"block {number}: {error}") from None
            fields.append((field.place, signal))
        blocks[number] = DataBlock(tuple(fields), max(place.end for place, _ in fields))
    return blocks
