"""The DDS library writes a line for every malformed packet: a stranger's would fill the disk."""

import asyncio
import contextlib
import ctypes
import socket
from pathlib import Path

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
            stranger.sendto(
                b"RTPS\x02\x01" + b"\xff" * 60, ("127.0.0.1", 7400 + 250 * 77 + 10)
            )
    await participant.close()
    written = capfd.readouterr().err
    assert "malformed" not in written
    assert "an error" in written


async def test_joining_opens_no_second_copy_of_other_files(tmp_path):
    """Its sockets are found among the files of the process, most of which are none."""
    with contextlib.ExitStack() as kept:
        kept.enter_context(await asyncio.to_thread((tmp_path / "other").open, "w"))
        participant = Participant(Ros2Config(enabled=True, interface="lo", domain=76))
        assert open_files().count(str(tmp_path / "other")) == 1
        await participant.close()


def open_files():
    links = []
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # the one that lists them
            links.append(str(entry.readlink()))
    return links
