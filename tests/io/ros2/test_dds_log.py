"""The DDS library writes a line for every malformed packet: a stranger's would fill the disk."""

import ctypes
import socket

from cyclonedds.internal import DDS

from hilserver.config.ros2 import Ros2Config
from hilserver.io.ros2.participant import Participant

ERROR, WARNING = 2, 4


async def test_its_warnings_are_off_and_its_errors_stay(capfd):
    participant = Participant(Ros2Config(enabled=True, interface="lo", domain=77))
    log = DDS._dll_handle.dds_log
    for level, text in ((WARNING, b"malformed packet\n"), (ERROR, b"an error\n")):
        log(ctypes.c_uint32(level), b"file.c", 1, b"function", text)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for _ in range(100):
            stranger.sendto(b"RTPS\x02\x01" + b"\xff" * 60, ("127.0.0.1", 7400 + 250 * 77 + 10))
    await participant.close()
    written = capfd.readouterr().err
    assert "malformed" not in written
    assert "an error" in written
