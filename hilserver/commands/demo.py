"""`hilserver run --demo`: an embedded controller in a process of its own, over the real path.

The controller is an OPC UA server as on the IOT2050; the daemon is its client. Nothing is
short-circuited: what the demo shows is what a real controller gets.
"""

import asyncio
import contextlib
import dataclasses
import re
import signal
import sys
from collections.abc import AsyncIterator

from hilserver.controller.nodes import demo_peer
from hilserver.daemon.assembly import Assembly
from hilserver.errors import FailedError
from hilserver.plant.parameters import RobotParameters

READY = re.compile(rb"listening on (opc\.tcp://\S+)")
START_LIMIT_S = 30.0
STOP_LIMIT_S = 5.0


@contextlib.asynccontextmanager
async def running_controller(
    robot: RobotParameters, *, pattern: str = "eight"
) -> AsyncIterator[str]:
    """Run the controller for `robot` while the context lasts; give its endpoint.

    Parameters
    ----------
    pattern : str
        ``eight``, or ``wheels``: each wheel alone, as `hilserver wiring` asks for.

    Raises
    ------
    FailedError
        If it does not come up.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "hilserver.controller",
        "--endpoint",
        "opc.tcp://127.0.0.1:0/UA/NodeRedAgv",
        f"--wheel-radius-m={robot.wheel_radius_m}",
        f"--k-om-per-m={robot.k_om}",
        f"--yaw-sign={robot.yaw_sign}",
        f"--max-rpm={robot.max_rpm}",
        f"--pattern={pattern}",
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        start_new_session=True,  # Ctrl-C ends the daemon first, and the daemon ends the controller
    )
    try:
        yield await _endpoint_of(process)
    finally:
        await _stop(process)


async def _endpoint_of(process: asyncio.subprocess.Process) -> str:
    stdout = process.stdout
    if stdout is None:
        raise FailedError("the embedded controller has no output")
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(START_LIMIT_S):
            while line := await stdout.readline():
                if match := READY.search(line):
                    return match.group(1).decode()
    raise FailedError("the embedded controller did not start; see its messages above")


async def _stop(process: asyncio.subprocess.Process) -> None:
    if process.returncode is not None:
        return
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(signal.SIGTERM)
    try:
        async with asyncio.timeout(STOP_LIMIT_S):
            await process.wait()
    except TimeoutError:
        process.kill()
        await process.wait()


def demo_assembly(assembly: Assembly, endpoint: str) -> Assembly:
    """Return the same robot with the embedded controller as its only peer."""
    control = assembly.config.control.model_copy(update={"source": "peer"})
    config = assembly.config.model_copy(
        update={"peers": (demo_peer(endpoint),), "control": control}
    )
    return dataclasses.replace(assembly, config=config)
