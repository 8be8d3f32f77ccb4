"""A running daemon with a shield, and hosts written in C that drive it."""

import array
import asyncio
import contextlib
import fcntl
import json
import shutil
import subprocess
import termios
from pathlib import Path

import numpy as np
import pytest
import pytest_asyncio

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.io.shield import words as w

SOURCE = Path(__file__).with_name("host.c")
WAIT_S = 120.0
NEVER_SILENT_NS = 600_000_000_000
"""A host on a busy computer may pause; tests of silence set their own limit."""


@pytest.fixture(scope="session")
def host_program(tmp_path_factory):
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.fail(
            "the hosts need a C compiler (Debian: gcc libc6-dev)", pytrace=False
        )
    program = tmp_path_factory.mktemp("host") / "host"
    command = [
        compiler,
        "-O1",
        "-Wall",
        "-Werror",
        "-o",
        str(program),
        str(SOURCE),
        "-lm",
    ]
    subprocess.run(command, check=True, timeout=600)
    return program


class Robot:
    """A daemon with its shield, seen from a test."""

    def __init__(self, daemon, program):
        self.daemon, self.shield, self._program = daemon, daemon.part("shield"), program

    @property
    def status(self):
        return self.shield.status

    @property
    def device(self):
        return self.shield.device

    def read(self, name):
        frame = self.daemon.image.latest()
        return float(frame.values[self.daemon.table.slot(name)])

    def setpoints(self):
        wheels = ("fl", "rl", "fr", "rr")
        return [
            self.daemon.gate.newest(f"wheel.{wheel}.setpoint_rpm") for wheel in wheels
        ]

    async def until(self, condition, what):
        try:
            async with asyncio.timeout(WAIT_S):
                while not condition():  # noqa: ASYNC110 - another process fulfils it
                    await asyncio.sleep(0.01)
        except TimeoutError:
            pytest.fail(f"not within {WAIT_S:g} s: {what}")

    @contextlib.asynccontextmanager
    async def started_host(self, **options):
        words = [f"{key}={value}" for key, value in options.items()]
        process = await asyncio.create_subprocess_exec(
            *(self._program, self.shield.address, *words),
            stdout=asyncio.subprocess.PIPE,
        )
        try:
            yield process
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()

    async def host(self, **options):
        """Run a host to its end; return what it saw, once all that it sent is done."""
        async with self.started_host(**options) as process:
            async with asyncio.timeout(WAIT_S):
                out, _ = await process.communicate()
            assert process.returncode == 0
        await self.until(self.is_idle, "everything is answered and obeyed")
        return json.loads(out)

    def is_idle(self):
        """Nothing is left to read, to answer or to obey."""
        unread, words = array.array("i", [0]), self.status.words
        fcntl.ioctl(self.shield._line.file, termios.FIONREAD, unread)
        return (
            unread[0] == words[w.RX_COUNT] == words[w.TX_COUNT] == 0
            and words[w.PENDING_TAIL] == words[w.PENDING_HEAD]
            and words[w.RING_TAIL] == words[w.RING_HEAD]
        )

    def writes(self):
        """Return due and written times of all responses [ns], shape (n, 2)."""
        rows = self.status.words[w.STAMP_ROWS :].reshape(-1, 2)
        n = self.status.count(w.RESPONSES)
        assert n <= len(rows), "the ring of stamps has gone round"
        return rows[:n].copy()

    async def forget(self):
        """Begin anew: no fault, no count, no host, nothing to do."""
        await self.until(self.is_idle, "the last host's requests are done")
        self.device.limit_ns = NEVER_SILENT_NS
        self.status.words[w.RAW] = 1
        for word in (
            w.SKIPPED,
            w.UNTERMINATED,
            w.REQUESTS,
            w.RESPONSES,
            w.UNANSWERED,
            w.BYTES,
        ):
            self.status.words[word] = 0
        self.shield._seen.clear()
        self.status.requests.clear()
        self.status.fault_counts.clear()
        self.status.parameters.clear()


def configuration(folder, **shield):
    return Config.model_validate(
        {
            "image": {"name": "auto"},
            "opcua": {"enabled": False},
            "metrics": {"enabled": False},
            "page": {"enabled": False},
            "scheduler": {
                "limits": {"single_overrun_ms": None, "consecutive_overruns": None},
                "realtime": {
                    "priority": 0,
                    "lock_memory": False,
                    "hold_latency_target": False,
                },
                "communication_timeout_ms": 0,
            },
            "shield": {"enabled": True, "link": str(folder / "shield"), **shield},
        }
    )


@contextlib.asynccontextmanager
async def running_robot(folder, program, **shield):
    async with Daemon(
        assemble_config(configuration(folder, **shield), folder)
    ) as daemon:
        yield Robot(daemon, program)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def robot(tmp_path_factory, host_program):
    async with running_robot(tmp_path_factory.mktemp("line"), host_program) as robot:
        yield robot


def random_bytes(count, seed=1):
    return np.random.default_rng(seed).integers(0, 256, count, dtype=np.uint8).tobytes()
