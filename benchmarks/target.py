"""The daemon under measurement: a process of its own on loopback."""

import asyncio
import contextlib
import subprocess
import tempfile
import time
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from asyncua import ua

from benchmarks.wire import Wire
from hilserver.errors import FailedError
from hilserver.program.children import free_port, piped, python

START_WITHIN_S = 300.0


@contextlib.asynccontextmanager
async def running_daemon(
    settings: Mapping[str, Any], image: str, *arguments: str
) -> "AsyncIterator[tuple[str, subprocess.Popen[str]]]":
    """Start a daemon with these settings; give its address and its process."""
    with tempfile.TemporaryDirectory(prefix="hilserver-") as folder:
        url = f"opc.tcp://127.0.0.1:{free_port()}/hilserver"
        ours = {
            "image": {"name": image},
            "opcua": {"endpoint": url},
            "metrics": {"enabled": False},
            "page": {"enabled": False},
            "logging": {"level": "ERROR"},
        }
        path = Path(folder) / "config.yaml"
        path.write_text(yaml.safe_dump({**ours, **settings}), encoding="utf-8")
        command = python("-m", "hilserver", "run", "-c", str(path), *arguments)
        with piped(command, name="hilserver run") as daemon:
            await _wait_for_server(url, daemon)
            yield url, daemon


async def _wait_for_server(url: str, daemon: "subprocess.Popen[str]") -> None:
    deadline = time.monotonic() + START_WITHIN_S
    while time.monotonic() < deadline and daemon.poll() is None:
        with contextlib.suppress(OSError, ua.UaError, TimeoutError):
            async with Wire(url) as wire:
                await wire.log_in()
                value = (await wire.read(ua.NodeId("sim.state", 2)))[0].Value
                if value is not None and value.Value == 1:  # running
                    return
        await asyncio.sleep(0.2)
    raise FailedError(f"the daemon did not start within {START_WITHIN_S:.0f} s")
