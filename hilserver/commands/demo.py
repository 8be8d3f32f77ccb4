"""`hilserver run --demo`: an embedded controller in a process of its own, over the real path.

The controller is an OPC UA server as on the IOT2050; the daemon is its client. Nothing is
short-circuited: what the demo shows is what a real controller gets.
"""

import asyncio
import contextlib
import dataclasses
import re
import shlex
from collections.abc import AsyncIterator

from hilserver.config.peers import PeerConfig
from hilserver.config.recalibration import RecalibrationConfig
from hilserver.config.timing import LimitsConfig
from hilserver.controller.nodes import demo_peer
from hilserver.daemon.assembly import Assembly, assemble_config
from hilserver.errors import FailedError
from hilserver.plant.parameters import RobotParameters
from hilserver.program import children
from hilserver.time_limit import time_limit

TWIN = RecalibrationConfig(enabled=True, window_s=120, every_s=60, nice=5, limit_s=600)
READY = re.compile(rb"listening on (opc\.tcp://\S+)")
START_LIMIT_S = 600.0
"""Only for one that hangs: a busy computer takes minutes, and one that ends is noticed at once."""
ENDS_WITHIN_S = 5.0
STALE_AFTER_MS = 2000.0
"""A controller that shares a busy computer's cores may pause without being lost."""


@contextlib.asynccontextmanager
async def running_controller(
    robot: RobotParameters, *, pattern: str = "eight"
) -> AsyncIterator[str]:
    """Run the controller for `robot` while the context lasts; give its endpoint.

    `pattern`: ``eight``, or ``wheels``: each wheel alone, as `hilserver wiring` needs.
    FailedError if it does not start.
    """
    command = children.python(
        "-m",
        "hilserver.controller",
        "--endpoint",
        "opc.tcp://127.0.0.1:0/UA/NodeRedAgv",
        f"--wheel-radius-m={robot.wheel_radius_m}",
        f"--k-om-per-m={robot.k_om}",
        f"--yaw-sign={robot.yaw_sign}",
        f"--max-rpm={robot.max_rpm}",
        f"--pattern={pattern}",
    )
    async with _serving(command, "controller") as endpoint:
        yield endpoint


@contextlib.asynccontextmanager
async def running_robot() -> AsyncIterator[str]:
    """Run the "real robot" of the twin while the context lasts; give its endpoint.

    FailedError if it does not start.
    """
    command = children.python("-m", "hilserver.recalibration.robot")
    async with _serving(command, "robot") as endpoint:
        yield endpoint


@contextlib.asynccontextmanager
async def _serving(command: list[str], name: str) -> AsyncIterator[str]:
    async with children.started(
        command, name=name, stop_limit_s=0.0, stdout=asyncio.subprocess.PIPE
    ) as process:
        ready = await children.line_of(process, READY, START_LIMIT_S)
        if ready is None:
            raise FailedError(await _why_not(process, name, shlex.join(command)))
        yield ready.group(1).decode()


async def _why_not(process: asyncio.subprocess.Process, name: str, command: str) -> str:
    """Return why a child does not listen: it has ended, or it hangs."""
    with contextlib.suppress(TimeoutError):
        async with time_limit(ENDS_WITHIN_S):
            await process.wait()
    if process.returncode is None:
        waited = (
            f"after {START_LIMIT_S:g} s: the computer is too busy, or the start hangs"
        )
        return f"the embedded {name} runs, but does not listen {waited}"
    how = children.how_ended(process.returncode)
    return f"the embedded {name} {how} before it listened; to see why, run {command}"


def demo_assembly(assembly: Assembly, endpoint: str) -> Assembly:
    """Return the same robot with the embedded controller as its only peer."""
    return _with_peer(
        assembly, demo_peer(endpoint).changed(stale_after_ms=STALE_AFTER_MS)
    )


def twin_assembly(assembly: Assembly, endpoint: str) -> Assembly:
    """Return the same robot beside a "real" one that drives, with recalibration on.

    Windows of two minutes are diagnosed one after the other; a configuration with recalibration
    switched on keeps its own.
    """
    from hilserver.recalibration.robot import peer  # noqa: PLC0415 - brings the injector along

    assembly = _with_peer(assembly, peer(endpoint))
    own = assembly.config.recalibration
    config = assembly.config.changed(
        recalibration=own if own.enabled else TWIN, sensors={"nav": {"enabled": True}}
    )
    twin_of = assemble_config(config, assembly.folder, assembly.patch)
    return dataclasses.replace(
        twin_of, path=assembly.path, from_file=assembly.from_file
    )


def _with_peer(assembly: Assembly, peer: PeerConfig) -> Assembly:
    """Return the same robot with one peer, which drives.

    The default overrun limits are off: a laptop that wakes from sleep would be in the safe state.
    """
    config = assembly.config.changed(peers=(peer,), control={"source": "peer"})
    if config.scheduler.limits == LimitsConfig():
        none = LimitsConfig(single_overrun_ms=None, consecutive_overruns=None)
        config = config.changed(scheduler={"limits": none})
    return dataclasses.replace(assembly, config=config)
