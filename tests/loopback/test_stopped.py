"""A daemon that is stopped by a signal: what was sent meanwhile does not drive after it."""

import asyncio
import signal
import socket
import time
from pathlib import Path

from asyncua import ua

from hilserver.image import ImageReader
from tests.helpers.daemons import running_daemon
from tests.io.opcua_server.rig import RobotClient
from tests.loopback.rig import wait_until

FL = "wheel.fl.setpoint_rpm"
DEADMAN_S, STOPPED_S = 0.5, 2.0
CONFIG = f"""
control: {{source: opcua}}
page: {{enabled: false, deadman_ms: {DEADMAN_S * 1e3:g}}}
scheduler:
  communication_timeout_ms: 0
  limits: {{single_overrun_ms: null, consecutive_overruns: null}}
  realtime: {{priority: 0, lock_memory: false, hold_latency_target: false}}
"""


class AtOnce:
    """A transport that sends in the call, whatever the event loop does."""

    def __init__(self, transport):
        self._transport, self.sent = transport, 0

    def __getattr__(self, name):
        return getattr(self._transport, name)

    def write(self, data):
        connection = socket.socket(fileno=self._transport.get_extra_info("socket").fileno())
        connection.send(data)
        connection.detach()
        self.sent += 1


async def test_what_was_sent_while_it_was_stopped_does_not_drive_after_it(tmp_path):
    with running_daemon(tmp_path, config=CONFIG) as daemon:
        image = ImageReader.attach(daemon.image)
        slots = {row["name"]: row["slots"][0] for row in image.description["signals"]}
        client = RobotClient(daemon.url)
        client.description = "teleop"
        await client.connect()
        protocol = client.uaclient.protocol
        protocol.transport = transport = AtOnce(protocol.transport)

        async def drives(rpm):
            assert await client.write((FL, rpm, ua.VariantType.Double)) == ["Good"]
            return image.latest().values[slots[FL]] == rpm

        await wait_until(lambda: drives(20.0))
        stopped(daemon.process)
        before = transport.sent
        sent = asyncio.create_task(client.write((FL, 50.0, ua.VariantType.Double)))
        while transport.sent == before:  # noqa: ASYNC110 - a step of the loop, not a time
            await asyncio.sleep(0)
        time.sleep(STOPPED_S)  # noqa: ASYNC251 - nothing of it is sent later
        head = image.head
        daemon.process.send_signal(signal.SIGCONT)
        assert await sent == ["Good"]
        frames = []

        def has_gone_on():  # read as they come: the ring does not keep them for ever
            frames.extend(image.frame(n) for n in range(head + len(frames), image.head))
            return len(frames) > 500

        await wait_until(has_gone_on)
        assert 50.0 not in {frame.values[slots[FL]] for frame in frames if frame is not None}
        await wait_until(lambda: drives(30.0))
        await client.disconnect()


def stopped(process):
    """Stop a process and wait until all of its threads stand."""
    process.send_signal(signal.SIGSTOP)
    tasks = Path(f"/proc/{process.pid}/task")
    while any(_state(task) != "T" for task in tasks.iterdir()):
        time.sleep(0.01)


def _state(task):
    return (task / "stat").read_text().rpartition(")")[2].split()[0]
