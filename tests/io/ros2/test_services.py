"""Services of rmw_cyclonedds: the identity of a request stands in the message and comes back."""

import struct

from tests.io.ros2.rig import PATIENCE_S, Host, robot, value
from tests.loopback.rig import wait_until

ENABLE = "iotbot_interface/srv/SendEnable"
CALL, ANSWER = "rq/iotbot/srv/send_enableRequest", "rr/iotbot/srv/send_enableReply"
GUID = 0x0123456789ABCDEF


async def test_a_service_answers_to_who_asked(cyclone, domain):
    host = Host(
        cyclone,
        domain,
        ("w", CALL, f"{ENABLE}_Request", "reliable"),
        ("r", ANSWER, f"{ENABLE}_Response", "reliable"),
    )
    async with robot(domain, rmw="cyclonedds") as daemon, host:
        await wait_until(lambda: value(daemon, "drive.enable") == 1.0, PATIENCE_S)
        asked = []

        def is_answered():
            """Ask until our reader of answers is known over there."""
            number = 7 + len(asked)
            asked.append(number)
            host.write_cdr(CALL, b"\0\1\0\0" + struct.pack("<QqB", GUID, number, 0))
            return bool(host.received[ANSWER])

        await wait_until(is_answered, PATIENCE_S)
        guid, number, done = struct.unpack_from("<QqB", host.received[ANSWER][0], 4)
        assert (guid, done) == (GUID, True)
        assert number in asked
        await wait_until(lambda: value(daemon, "drive.enable") == 0.0, PATIENCE_S)
