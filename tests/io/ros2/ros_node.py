"""Real `rclpy` nodes beside the tests: where their Python is, and how they are spoken to."""

import asyncio
import json
import os
from pathlib import Path

import pytest

from tests.io.ros2.rig import PATIENCE_S
from tests.loopback.rig import wait_until

ROOT = Path(__file__).parents[3]
PYTHON = ROOT / "build" / "ros" / "bin" / "python"
"""Made by ``make test-tools`` if there is a Python 3.12, for which `rclpy` has wheels."""
LOGS = ROOT / "build" / "ros-logs"
SCRIPT = Path(__file__).with_name("rclpy_node.py")

needs_rclpy = pytest.mark.skipif(
    not PYTHON.exists(),
    reason="no real ROS 2 node: rclpy needs python3.12, then make test-tools installs it",
)


class RosNode:
    """A node of a real ROS 2.

    Parameters
    ----------
    publish, subscribe : dict of str
        Topic to type.
    discovery : str, optional
        ROS_AUTOMATIC_DISCOVERY_RANGE; None: its default, which sends multicast to every network.
    prefix : tuple of str
        Put before the command.
    more : dict of str
        Further environment variables.
    """

    def __init__(
        self,
        domain,
        publish=None,
        subscribe=None,
        *,
        discovery="LOCALHOST",
        prefix=(),
        name="host",
        more=(),
    ):
        about = {"name": name, "publish": publish or {}, "subscribe": subscribe or {}}
        self._command = [*prefix, str(PYTHON), str(SCRIPT), json.dumps(about)]
        kept = {
            name: value for name, value in os.environ.items() if name != "PYTHONPATH"
        }
        own = {"ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(LOGS)}
        self._environment = kept | own | dict(more)
        if discovery is not None:
            self._environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = discovery
        self.domain = domain
        self.received = {topic: [] for topic in subscribe or {}}
        self.said = []

    async def __aenter__(self):
        pipe = asyncio.subprocess.PIPE
        self.process = await asyncio.create_subprocess_exec(
            *self._command,
            stdin=pipe,
            stdout=pipe,
            env=self._environment,
            limit=1 << 20,
        )
        self._reading = asyncio.create_task(self._read())
        return self

    async def __aexit__(self, *_):
        if self.process.returncode is None:
            self.process.stdin.close()
        try:
            await asyncio.wait_for(self.process.wait(), 10.0)
        except TimeoutError:
            self.process.kill()
            await self.process.wait()
        await self._reading

    async def _read(self):
        async for line in self.process.stdout:
            said = json.loads(line)
            if "topic" in said:
                self.received[said["topic"]].append(said["fields"])
            else:
                self.said.append(said)

    async def is_ready(self):
        """Wait until each of its publishers has found a reader."""
        await self.answers("ready")

    def tell(self, **command):
        self.process.stdin.write(json.dumps(command).encode() + b"\n")

    def publish(self, topic, times=1, **fields):
        """Write a message, or one every 20 ms."""
        self.tell(publish=topic, fields=fields, times=times)

    def play(self, path):
        """Write the messages of a drive at their times; ``played`` is the answer at its end."""
        self.tell(play=str(path))

    async def answers(self, key):
        """Wait for something that it says besides messages; return it."""
        await self._until(lambda: any(key in said for said in self.said))
        (said, *_) = [said for said in self.said if key in said]
        self.said.remove(said)
        return said[key]

    async def sees(self, topic, condition=lambda _: True):
        """Wait for a message that meets a condition; return it."""
        messages = self.received[topic]
        await self._until(lambda: messages and condition(messages[-1]))
        return messages[-1]

    async def _until(self, condition):
        def met():
            assert self.process.returncode is None, "the node has ended by itself"
            return condition()

        await wait_until(met, PATIENCE_S)
