"""The serial protocol of the extension shield: commands, requests, responses.

A request is 11 bytes, ``FF command payload[8] end``; the end is ``EE``, or a check sum with the
variant ``crc``. A response is 32 or 33 bytes without a start byte, little endian:

| byte | field |
|---|---|
| 0 | the command, echoed |
| 1-8 | speeds of the four channels, int16, 0.01 rpm |
| 9-20 raw | acceleration z, -y, x [g / 10000] and turn rate z, -x, y [0.01 deg/s], int16 |
| 9-18 fused | quaternion w x y z, int16 / 10000, and temperature, int16, 0.01 degC |
| 21-28 | range finders fl fr rl rr, uint16, mm |
| 29-30 | battery voltage, uint16, 0.01 V |
| 31 | ``iotbot``: current, uint8, 0.05 A; ``crc``: temperature, int8, degC |
| 32 | ``crc``: check sum |
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from hilserver.compiled import inlined
from hilserver.config.shield import Variant

START: Final = 0xFF
END: Final = 0xEE
REQUEST_BYTES: Final = 11
PAYLOAD_BYTES: Final = 8
RESPONSE_BYTES: Final[dict[Variant, int]] = {"iotbot": 32, "crc": 33}
BAUD: Final = 115200
BYTE_NS: Final = 10 * 1_000_000_000 // BAUD + 1  # start, eight bits, stop; rounded up


class ShieldCommand(IntEnum):
    """What a request asks for."""

    ENABLE = 0x01
    DISABLE = 0x02
    TIMEOUT = 0x03
    PWM_MAX = 0x04
    SEND_RPM = 0x05
    SEND_POSITION = 0x06
    INVERT_ENCODER = 0x07
    LOW_VOLTAGE_CHECK = 0x08
    STALL_CHECK = 0x09
    IMU_RAW = 0x0A
    IMU_WEIGHT = 0x0B
    UART_TIMEOUT = 0x0C
    IMU_CALIBRATE = 0x0D
    IMU_FIX_Z = 0x0E
    SET_PWM = 0x10
    SET_RPM = 0x11
    FREQUENCY = 0x12
    SYNC = 0x13
    KP = 0x20
    KI = 0x21
    KD = 0x22
    ANTI_WINDUP = 0x23
    INPUT_FILTER = 0x24
    ENCODER_LOW_PASS = 0x25
    GEAR_RATIO = 0x30
    TICKS_PER_REVOLUTION = 0x31
    AUX1 = 0x40
    AUX2 = 0x41
    LIGHTS_OFF = 0x42
    LIGHTS_DIM = 0x43
    LIGHTS_HIGH_BEAM = 0x44
    LIGHTS_FLASH_ALL = 0x45
    LIGHTS_FLASH_LEFT = 0x46
    LIGHTS_FLASH_RIGHT = 0x47
    LIGHTS_PULSATION = 0x48
    LIGHTS_ROTATION = 0x49
    LIGHTS_RUNNING = 0x4A


KNOWN: Final = frozenset(ShieldCommand)
NAMES: Final = (*(command.name.lower() for command in ShieldCommand), "unknown")
"""Names of requests, as metrics count them."""


@dataclass(frozen=True, slots=True)
class Request:
    """One request as it came in."""

    command: int  # a `Command`, or an unknown number
    payload: bytes  # eight bytes
    received_ns: int = 0  # CLOCK_MONOTONIC at which its last byte had come in
    # False: alone on the line, but its last byte is not `END`
    is_terminated: bool = True

    @property
    def name(self) -> str:
        """Name in metrics and messages: ``set_rpm``, ``unknown``."""
        return (
            ShieldCommand(self.command).name.lower()
            if self.command in KNOWN
            else "unknown"
        )

    @property
    def number(self) -> float:
        """The payload's first four bytes as a float."""
        return float(struct.unpack_from("<f", self.payload)[0])

    @property
    def integer(self) -> int:
        """The payload's first four bytes as an unsigned integer."""
        return int(struct.unpack_from("<I", self.payload)[0])

    @property
    def speeds_rpm(self) -> tuple[float, ...]:
        """Commanded speeds of the channels 0 to 3."""
        return tuple(value / 100 for value in struct.unpack("<4h", self.payload))

    @property
    def duties_pct(self) -> tuple[int, ...]:
        """Commanded duties of the channels 0 to 3."""
        return struct.unpack_from("<4b", self.payload)


@inlined
def crc8(data: bytes, first: int, length: int) -> int:
    """Return the CRC-8 (polynomial 0x07, initial value 0) of `length` bytes from `first` on."""
    crc = 0
    for i in range(first, first + length):
        crc ^= data[i]
        for _ in range(8):
            crc = (crc << 1 ^ 0x07) & 0xFF if crc & 0x80 else crc << 1
    return crc


CHECKED_BYTES: Final = 8
"""The variant's driver computes over the size of a pointer, whatever the frame's length."""


def request(command: int, payload: bytes = b"", variant: Variant = "iotbot") -> bytes:
    """Return the 11 bytes of a request; a shorter payload is filled up with zeros."""
    body = bytes((START, command)) + payload.ljust(PAYLOAD_BYTES, b"\0")
    return body + bytes((END if variant == "iotbot" else crc8(body, 0, CHECKED_BYTES),))
