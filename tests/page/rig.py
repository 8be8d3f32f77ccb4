"""A daemon with its page, the plant behind it, and a browser."""

import contextlib
import json
import os
import queue
import shutil
import subprocess
import threading
import time
from pathlib import Path

import numpy as np

from hilserver.image import ImageReader, read_frames
from tests.io.opcua_server.rig import RobotClient

HERE = Path(__file__).parent
RUNNING, SAFE = 1, 3
SETPOINTS = tuple(f"wheel.{wheel}.setpoint_rpm" for wheel in ("fl", "rl", "fr", "rr"))
SEEN = (
    "sim.tick",
    "sim.state",
    "control.mode",
    "twist.linear_m_s",
    "twist.angular_rad_s",
    "velocity.linear_m_s",
    "velocity.angular_rad_s",
    "measured.velocity.angular_rad_s",
)
DEADMAN_MS = 300
ANSWER_S = 300.0
PRESSES = 10
KEPT = 15_000
"""Frames that are looked at: somewhat fewer than the ring of the daemon holds."""


class Plant:
    """What the plant has latched, read where the page reads it."""

    def __init__(self, image):
        self.reader = ImageReader.attach(image)
        self.slots = {
            s["name"]: s["slots"][0] for s in self.reader.description["signals"]
        }
        read_frames(self.reader, 0, 1)  # compiles it

    def value(self, name):
        return float(self.reader.latest().values[self.slots[name]])

    def command(self):
        """The largest set-point, twist or wheel."""
        names = ("twist.linear_m_s", "twist.angular_rad_s", *SETPOINTS)
        return max(abs(self.value(name)) for name in names)

    def wait(self, condition, timeout_s=150.0):
        """Wait until `condition()`."""
        start_s = time.monotonic()
        while not condition():
            assert time.monotonic() - start_s < timeout_s, (
                f"it did not come: {self.seen()}"
            )
            time.sleep(0.02)

    def seen(self):
        """What the plant does, for whoever waits for something else."""
        return {name: self.value(name) for name in SEEN}

    def silence_ms(self):
        """How long the last command was held without a new one until it ended, in ticks of 1 ms.

        Asked once the robot stands: from the last frame before the end into which anything was
        latched, to the first one whose set-points are zero.
        """
        frames = read_frames(self.reader, max(0, self.reader.head - KEPT), KEPT)
        names = ("twist.linear_m_s", "twist.angular_rad_s", *SETPOINTS)
        held = (
            np.abs(frames.values[:, [self.slots[name] for name in names]]).max(axis=1)
            > 0
        )
        end = int(np.flatnonzero(held)[-1]) + 1
        latched = frames.words[:end, 2]
        last = int(np.flatnonzero(np.diff(latched))[-1]) + 1
        return int(frames.ticks[end] - frames.ticks[last])


def reset(browser, plant):
    """Press Reset until the robot is back, as an operator would.

    On a slow computer the page sends a Stop twice, and the second may come after the first Reset.
    """
    for _ in range(PRESSES):
        browser.do("wait", selector=".banner button", text="Reset")
        browser.do("click", role="button", name="Reset")
        with contextlib.suppress(AssertionError):
            plant.wait(lambda: plant.value("sim.state") == RUNNING, timeout_s=10.0)
            return
    raise AssertionError(f"Reset was pressed {PRESSES} times: {plant.seen()}")


async def restart(url):
    """Reset and Start as an OPC UA client, whatever a test before has left."""
    client = RobotClient(url)
    await client.connect()
    for method in ("Reset", "Start"):
        await client.call(method)
    await client.disconnect()


def page_url(daemon):
    """The address that `hilserver run` prints."""
    lines = (daemon.folder / "daemon.log").read_text(encoding="utf-8").splitlines()
    return next(
        said["url"]
        for said in map(json.loads, lines)
        if said["event"] == "operator page"
    )


def page_process(daemon):
    """The page of a daemon, which starts a new one some time after the old one died."""
    words = ["pgrep", "-P", str(daemon.process.pid), "-f", "hilserver page"]
    end_s = time.monotonic() + 60
    while not (
        found := subprocess.run(
            words, capture_output=True, text=True, check=False
        ).stdout
    ):
        assert time.monotonic() < end_s, "the daemon has no page"
        time.sleep(0.1)
    return int(found.split()[0])


def diagnoses(daemon, command="diagnose"):
    """The processes of the diagnoses, or of another command, that run now."""
    words = ["pgrep", "-P", str(page_process(daemon)), "-f", command]
    found = subprocess.run(words, check=False, capture_output=True, text=True)
    return [int(pid) for pid in found.stdout.split()]


def lift(pid):
    """On a busy computer it would get no time at all; where we may, it gets some.

    Once it has lowered itself, that is: before, it would do so afterwards.
    """
    end_s = time.monotonic() + 60
    with contextlib.suppress(OSError):
        while os.sched_getscheduler(pid) != os.SCHED_IDLE and time.monotonic() < end_s:
            time.sleep(0.02)
        os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, pid, 0)
        Path(f"/proc/{pid}/autogroup").write_text("0", encoding="ascii")


class Browser:
    """Chromium, by one line of JSON after the other."""

    def __init__(self, *, webgl):
        node, chromium = shutil.which("node"), shutil.which("chromium")
        assert node, "Node.js is needed"
        assert chromium, "chromium is needed (Debian package chromium)"
        self.process = subprocess.Popen(
            [node, "browser.mjs", chromium, "webgl" if webgl else "plain"],
            cwd=HERE,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._lines = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, name="browser", daemon=True)
        self._reader.start()
        assert self.receive()["ready"]

    def _read(self):
        with self.process.stdout as lines:
            for line in lines:
                self._lines.put(line)
        self._lines.put("")

    def do(self, what, **more):
        self.send(what, **more)
        answer = self.receive()
        assert "error" not in answer, f"{what}: {answer['error']}"
        return answer["result"]

    def receive(self):
        """The answer to what was sent; one that does not come fails the test that waits."""
        try:
            line = self._lines.get(timeout=ANSWER_S)
        except queue.Empty:
            raise AssertionError(
                f"the browser has not answered for {ANSWER_S:g} s"
            ) from None
        assert line, "the browser has ended"
        return json.loads(line)

    def send(self, what, **more):
        """Ask without waiting for the answer."""
        self.process.stdin.write(json.dumps({"do": what, **more}) + "\n")
        self.process.stdin.flush()

    def close(self):
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            self.process.stdin.close()
            self.process.wait(600)
        self.process.kill()
        self.process.wait()
        self._reader.join(60)
