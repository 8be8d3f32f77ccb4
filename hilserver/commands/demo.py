"""`hilserver run --demo`: an embedded controller in a process of its own, over the real path.

The controller is an OPC UA server as on the IOT2050; the daemon is its client. Nothing is
short-circuited: what the demo shows is what a real controller gets.
"""

import asyncio
import contextlib
import dataclasses
import re
from collections.abc import AsyncIterator

from hilserver.config.timing import LimitsConfig
from hilserver.controller.nodes import demo_peer
from hilserver.daemon.assembly import Assembly
from hilserver.errors import FailedError
from hilserver.plant.parameters import RobotParameters
from hilserver.program import children

READY = re.compile(rb"listening on (opc\.tcp://\S+)")
START_LIMIT_S = 30.0
STALE_AFTER_MS = 2000.0
"""A controller that shares a busy computer's cores may pause without being lost."""


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
    async with children.started(
        command, name="controller", stop_limit_s=0.0, stdout=asyncio.subprocess.PIPE
    ) as process:
        ready = await children.line_of(process, READY, START_LIMIT_S)
        if ready is None:
            raise FailedError("the embedded controller did not start; see its messages above")
        yield ready.group(1).decode()


def demo_assembly(assembly: Assembly, endpoint: str) -> Assembly:
    """Return the same robot with the embedded controller as its only peer.

    The default limits of overruns are off: a laptop that slept would leave it in the safe state.
    """
    scheduler = assembly.config.scheduler
    if scheduler.limits == LimitsConfig():
        limits = LimitsConfig(single_overrun_ms=None, consecutive_overruns=None)
        scheduler = scheduler.model_copy(update={"limits": limits})
    control = assembly.config.control.model_copy(update={"source": "peer"})
    peer = demo_peer(endpoint).model_copy(update={"stale_after_ms": STALE_AFTER_MS})
    changes = {"peers": (peer,), "control": control, "scheduler": scheduler}
    config = assembly.config.model_copy(update=changes)
    return dataclasses.replace(assembly, config=config)
