"""What a client is answered that asks who this is: the identification of a controller's parts.

Of all user data (clocks, passwords, lists of blocks, cyclic services) it is the only one here.
"""

import struct
from typing import Final

from hilserver import __version__
from hilserver.io.s7 import wire
from hilserver.io.s7.wire import Job

_READ_LIST: Final = b"\x44\x01"
"""Group of CPU functions, and the function that reads a list of the system's state."""
COMPONENTS: Final = 0x001C
NO_INFORMATION: Final = 0xD401
_TEXTS: Final = {1: "hilserver", 2: "robot", 3: "", 4: "MIT", 5: __version__, 7: "simulated robot"}
"""Index of a record: name of the station, of the module, plant, copyright, serial number, type."""


def identified(message: Job) -> bytes:
    """Return the answer to a request of user data."""
    parameters, data = message.parameters, message.data
    if len(parameters) < 8 or len(data) < 4:
        raise wire.WireError("asks for no user data")
    wanted = struct.unpack(">HH", data[4:8]) if len(data) >= 8 else (0, 0)
    if parameters[5:7] != _READ_LIST or wanted[0] != COMPONENTS:
        return _answer(message, b"\x0a\0\0\0", NO_INFORMATION)
    records = [struct.pack(">H32s", i, text.encode()) for i, text in _TEXTS.items()]
    body = struct.pack(">HHHH", *wanted, 34, len(records)) + b"".join(records)
    return _answer(message, struct.pack(">BBH", 0xFF, 9, len(body)) + body, 0)


def _answer(message: Job, data: bytes, error: int) -> bytes:
    group, function, number = message.parameters[5] | 0x80, *message.parameters[6:8]
    parameters = struct.pack(
        ">BBBBBBBBBBH", 0, 1, 0x12, 8, 0x12, group & 0xBF, function, number, 0, 0, error
    )
    return wire.user_data(message.number, parameters, data)
