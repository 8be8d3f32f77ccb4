"""A real daemon in a process of its own, on a free port and with an image of its own."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from hilserver.image.shared_file import path_of
from tests.fakes import image_name

START_LIMIT_S = 600
RUNNING = '"hilserver is running"'


def free_port() -> int:
    """Return a TCP port that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class RunningDaemon:
    process: subprocess.Popen
    image: str
    url: str
    metrics_url: str
    folder: object

    def stop(self):
        """End it as systemd would; return its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(600)

    def kill(self):
        self.process.kill()
        self.process.wait(600)


NO_LIMITS = """
scheduler:
  communication_timeout_ms: 0
  limits: {single_overrun_ms: null, consecutive_overruns: null}
"""
"""For a robot that has to drive on where a busy computer holds it up."""


@contextlib.contextmanager
def running_daemon(
    folder,
    *options,
    config="",
    opcua="",
    ring_frames=1 << 14,
    prepare=None,
    program="hilserver",
    stdin=None,
):
    """Start ``hilserver run`` in `folder`; `config` is added to its config.yaml.

    `opcua` is added to that section; `prepare` is called with the folder before the start.
    `program` is the module that is run instead.
    """
    image = image_name()
    text = f"image: {{name: {image}, ring_frames: {ring_frames}}}\n"
    text += f"opcua: {{endpoint: 'opc.tcp://127.0.0.1:0/h', {opcua}}}\n"
    page = "" if "page:" in config else "\npage: {enabled: false}\n"
    limits = "" if "scheduler:" in config else NO_LIMITS
    text += f"metrics: {{port: 0}}\n{limits}{config}{page}"
    (folder / "config.yaml").write_text(text, encoding="utf-8")
    if prepare is not None:
        prepare(folder)
    errors = (folder / "daemon.log").open("w+", encoding="utf-8")
    command = [sys.executable, "-m", program, "run", "-c", "config.yaml", *options]
    # for programs of the tests
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    with (
        errors,
        subprocess.Popen(
            command, stderr=errors, cwd=folder, stdin=stdin, env=env
        ) as process,
    ):
        try:
            yield RunningDaemon(
                process, image, *_addresses(process, folder / "daemon.log"), folder
            )
        finally:
            process.kill()
            process.wait(600)
            # what a killed daemon leaves in /dev/shm
            path_of(image).unlink(missing_ok=True)


def _addresses(process, log):
    """Return the addresses of the OPC UA server and of the metrics."""
    for _ in range(START_LIMIT_S * 10):
        text = log.read_text(encoding="utf-8")
        if started := announced(text.splitlines()):
            return started["opcua"], started["metrics"]
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(0.1)
            break
    raise AssertionError(log.read_text(encoding="utf-8"))


def announced(lines):
    """Return the line in which a daemon says where it is reached; None while it has not."""
    found = (
        line
        for line in lines
        if '"hilserver is running"' in line and line.rstrip().endswith("}")
    )
    return next((json.loads(line) for line in found), None)


def recorder(daemon, out, *options, **popen):
    """Start ``hilserver record`` on a daemon's image; return it once it records."""
    process = start_recorder(daemon, out, *options, **popen)
    wait_for_start(process)
    return process


def start_recorder(daemon, out, *options, **popen):
    """Start ``hilserver record`` on a daemon's image."""
    command = [sys.executable, "-m", "hilserver", "record", "--image", daemon.image]
    return subprocess.Popen(
        [*command, "-o", str(out), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **popen,
    )


def wait_for_start(process):
    """Wait until a recorder records."""
    line = process.stdout.readline()
    assert line.startswith("recording to"), process.stderr.read()


def finish(process, timeout_s=600.0):
    """Wait for a process; return exit code and what it said on stderr."""
    _, text = process.communicate(timeout=timeout_s)
    return process.returncode, text
