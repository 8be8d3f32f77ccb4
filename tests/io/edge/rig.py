"""A real mosquitto, and clients of other makes."""

import asyncio
import json
import queue
import shutil
import socket
import subprocess
import time
from contextlib import contextmanager

import paho.mqtt.client as paho

BROKER = shutil.which("mosquitto") or "/usr/sbin/mosquitto"


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@contextmanager
def broker(folder, port, *settings):
    """Run mosquitto while the context lasts."""
    path = folder / "mosquitto.conf"
    lines = ["persistence false", "user root", f"listener {port} 127.0.0.1", *settings]
    path.write_text("\n".join(lines) + "\n")
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([BROKER, "-c", str(path)], **pipes) as process:
        try:
            for _ in range(200):
                with socket.socket() as probe:
                    if probe.connect_ex(("127.0.0.1", port)) == 0:
                        break
                time.sleep(0.05)
            yield process
        finally:
            process.kill()


class Reader:
    """A client in a thread of its own, which knows nothing but the metadata."""

    def __init__(self, port):
        self.messages = queue.Queue()
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        self._client.on_message = lambda *args: self.messages.put(args[2])
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def subscribe(self, topic):
        self._client.subscribe(topic, qos=1)

    async def next(self, topic, timeout_s=60.0):
        """Return the next message of a topic as JSON."""
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            try:
                message = self.messages.get_nowait()
            except queue.Empty:
                await asyncio.sleep(0.01)
                continue
            if message.topic == topic:
                return json.loads(message.payload)
        raise TimeoutError(topic)

    def write(self, topic, *values, **how):
        """Publish pairs of id and value as the common format wants it."""
        points = [{"id": name, "val": value} for name, value in values]
        self.send(topic, json.dumps({"seq": 1, "vals": points}), **how)

    def send(self, topic, data, *, retain=False):
        self._client.publish(topic, data, qos=1, retain=retain).wait_for_publish(30)

    def flood(self, topic, messages):
        for data in messages:
            self._client.publish(topic, data)

    def close(self):
        self._client.loop_stop()
        self._client.disconnect()
