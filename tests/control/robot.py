"""A daemon with every door open, and an eye that reads in shared memory what its wheels get."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from hilserver.image import ImageReader, read_frames
from hilserver.image.board import BoardReader
from hilserver.image.shared_file import path_of
from tests.fakes import image_name
from tests.helpers.daemons import RUNNING, free_port
from tests.io.ros2.rig import claimed_domain

RPM_PER_M_S = 60 / (2 * np.pi * 0.085)
RING_FRAMES = 1 << 14
START_WITHIN_S = 600
SAFE_RAMP_S = 0.1
COMMANDING = 0.0
SAFE = 3
STANDING_RPM = 0.05

LEASE_MS = {
    "peer": 1000,
    "page": 1000,
    "foxglove": 1000,
    "teleop": 1000,
    "ros2": 1000,
    "shield": 1000,
    "opcua": None,
    "scenario": None,
}
"""Silence after which a command lapses, as `configuration` sets it; None: it holds.

So long that neither a client nor a link that reconnects needs it up where others use the cores.
"""
COMMUNICATION_MS = 2500


def configuration(folder, domain, **control):
    """Every source there is, on ports that stay the same over restarts."""
    place = "127.0.0.1"
    peer = f"opc.tcp://{place}:{free_port()}/UA/NodeRedAgv"
    nodes = {
        f"rpm_set_{wheel.upper()}": f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS
    }
    nodes["enable"] = "drive.enable"
    return {
        "image": {"name": image_name(), "ring_frames": RING_FRAMES},
        "plant": {"safe_ramp_s": SAFE_RAMP_S},
        "control": {"source": "peer", **control},
        "opcua": {"endpoint": f"opc.tcp://{place}:{free_port()}/h"},
        "metrics": {"port": 0},
        "page": {"port": free_port(), "deadman_ms": LEASE_MS["page"]},
        "foxglove": {"enabled": True, "port": free_port()},
        "ros2": {"enabled": True, "domain": domain, "stale_after_ms": LEASE_MS["ros2"]},
        "shield": {"enabled": True, "stale_after_ms": LEASE_MS["shield"]},
        "peers": [
            {
                "name": "plc",
                "endpoint": peer,
                "mode": "poll",
                "poll_ms": 10,
                "stale_after_ms": LEASE_MS["peer"],
                "sequence_node": f"{PEER_NODES}seq",
                "read": {f"{PEER_NODES}{node}": name for node, name in nodes.items()},
            }
        ],
        "scheduler": {
            "limits": {"single_overrun_ms": None, "consecutive_overruns": None},
            "communication_timeout_ms": COMMUNICATION_MS,
        },
    }


WHEELS = ("fl", "rl", "fr", "rr")
PEER_NODES = "nsu=urn:iotbot:agv;s="


@dataclass(frozen=True)
class Doors:
    """Where the sources come in; plain text, so that other processes can be given it."""

    opcua: str
    page: str
    foxglove: str
    shield: str
    domain: int
    peer: str
    teleop: str


class Robot:
    """A daemon that can be stopped, killed, held up and started again."""

    def __init__(self, folder: Path, domain: int, **sections):
        self.folder = folder
        self.config = configuration(folder, domain, **sections.pop("control", {}))
        for name, section in sections.items():
            self.config[name] = self.config.get(name, {}) | section
        self.doors = Doors(
            self.config["opcua"]["endpoint"],
            f"http://127.0.0.1:{self.config['page']['port']}/",
            f"ws://127.0.0.1:{self.config['foxglove']['port']}",
            str(folder / "runtime/shield"),
            domain,
            self.config["peers"][0]["endpoint"],
            "",
        )

    def start(self):
        (self.folder / "config.yaml").write_text(
            yaml.safe_dump(self.config), encoding="utf-8"
        )
        log = self.folder / "daemon.log"
        command = [
            sys.executable,
            "-m",
            "tests.control.daemon",
            "run",
            "-c",
            "config.yaml",
        ]
        self.process = self._spawned(command, log)
        end_s = time.monotonic() + START_WITHIN_S
        while RUNNING not in log.read_text(encoding="utf-8"):
            assert self.process.poll() is None, log.read_text(encoding="utf-8")
            assert time.monotonic() < end_s, log.read_text(encoding="utf-8")
            time.sleep(0.05)
        self.eye = Eye(self.config["image"]["name"])

    def _spawned(self, command, log):
        with log.open("w", encoding="utf-8") as errors:
            return self._writing_to(errors, command)

    def _writing_to(self, errors, command):
        env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
        return subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=errors, cwd=self.folder, env=env
        )

    def hold(self, seconds):
        """Hold the interpreter lock of the daemon; returns at once."""
        self.process.stdin.write(f"{seconds}\n".encode())
        self.process.stdin.flush()

    def freeze(self, seconds):
        """Let no thread of the daemon run for a while."""
        self.process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self.process.send_signal(signal.SIGCONT)

    def stop(self, number=signal.SIGTERM):
        self.process.send_signal(number)
        self.process.wait(600)
        self.process.stdin.close()

    def events(self):
        """What the daemon has said so far, a dict per line."""
        lines = (self.folder / "daemon.log").read_text(encoding="utf-8").splitlines()
        found = []
        for line in lines:
            with contextlib.suppress(ValueError):
                found.append(json.loads(line))
        return found


@contextlib.contextmanager
def running_robot(folder, kind=Robot, **sections):
    with claimed_domain() as domain:
        robot = kind(folder, domain, **sections)
        try:
            robot.start()
            yield robot
        finally:
            if (process := getattr(robot, "process", None)) is not None:
                process.kill()
                process.wait(600)
                process.stdin.close()
            path_of(robot.config["image"]["name"]).unlink(missing_ok=True)


class Eye:
    """Reads what the plant has latched, tick by tick, in another process than the daemon."""

    def __init__(self, image):
        self.reader = ImageReader.attach(image)
        self.slots = {
            s["name"]: s["slots"][0] for s in self.reader.description["signals"]
        }
        self.board = BoardReader(self.reader)
        read_frames(self.reader, 0, 1)  # compiles it

    def now(self):
        """The newest frame, alone."""
        return self.since(self.reader.head - 1)

    def since(self, number):
        """Every frame from `number` on."""
        first = max(number, self.reader.head - RING_FRAMES + 512, 0)
        return History(read_frames(self.reader, first, RING_FRAMES), self.slots)

    @property
    def head(self):
        return self.reader.head

    def driver(self, within_s=3.0):
        """Who drives, as the board says that is written after this call."""
        number, end_s = self.board_number, time.monotonic() + within_s
        while self.board_number == number and time.monotonic() < end_s:
            time.sleep(0.01)
        return self.board.content["owner"]

    @property
    def board_number(self):
        """How many texts the board has had."""
        return int(self.reader.region("board")[1][0])


class History:
    """Frames one after the other."""

    def __init__(self, batch, slots):
        self._batch, self._slots = batch, slots

    def __len__(self):
        return len(self._batch)

    def __getitem__(self, name):
        """Values of a signal."""
        return self._batch.values[:, self._slots[name]]

    @property
    def times_ns(self):
        """When each tick was due, CLOCK_MONOTONIC."""
        return self._batch.planned_ns

    @property
    def wheel_rpm(self):
        """What the front left wheel is to do: set-point, twist, or duty, 0 while disabled.

        In the safe state NaN: there the plant ramps from what was commanded last to zero.
        """
        mode, twist = self["control.mode"], self["twist.linear_m_s"] * RPM_PER_M_S
        rpm = np.where(mode == 0, self["wheel.fl.setpoint_rpm"], twist)
        rpm = np.where(mode == 2, self["wheel.fl.duty_command_pct"], rpm)
        rpm = np.where(self["drive.enable"] == 0, 0.0, rpm)
        return np.where(self["internal.command"] == COMMANDING, rpm, np.nan)

    @property
    def stands(self):
        """Whether the front left wheel is to stand; in the safe state whatever is commanded."""
        return (np.abs(self.wheel_rpm) < STANDING_RPM) | (
            self["internal.command"] > COMMANDING
        )
