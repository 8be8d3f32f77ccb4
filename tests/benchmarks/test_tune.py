"""The client of `bench tune`: it changes parameters when it is asked to, and rests."""

import asyncio
import sys
from pathlib import Path

import hilserver
from benchmarks.tune import VALUES
from hilserver.testing.opening import open_hil
from tests.loopback.rig import wait_until

ROOT = Path(hilserver.__file__).parents[1]


async def test_it_changes_parameters_while_it_is_asked_to():
    config = {"opcua": {"endpoint": "opc.tcp://127.0.0.1:0/hilserver"}}
    async with open_hil(config, "realtime") as kit:
        changed = []
        write = kit.daemon.core.parameters.write

        def noted(source, values):
            changed.append(dict(values))
            return write(source, values)

        kit.daemon.core.parameters.write = noted
        command = [
            sys.executable,
            "-m",
            "benchmarks.tune",
            kit.daemon.part("opcua").url,
        ]
        process = await asyncio.create_subprocess_exec(
            *command, stdin=asyncio.subprocess.PIPE, cwd=ROOT
        )
        process.stdin.write(b"change\n")
        await wait_until(lambda: len(changed) >= 3)
        assert changed[-1].keys() == VALUES.keys()
        assert changed[-1] != changed[-2]
        assert "plant.controller.k_p" in kit.daemon.core.parameters.differing
        process.stdin.close()
        assert await process.wait() == 0
