"""Every query of the dashboard returns data from a running daemon, and moves when it should.

The stimuli come one after the other; each names the panels that it has to move, and how. A panel
without a stimulus fails the test.
"""

import asyncio
import contextlib
import functools
import gc
import json
import math
import os
import signal
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from hilserver.daemon.daemon import Daemon
from hilserver.errors import ControlRefused
from hilserver.io.shield.protocol import ShieldCommand, request
from hilserver.recalibration.proposals import Proposal, Quantity
from hilserver.signals import State
from tests.node_red.node_red import shipped_flow, test_flow
from tests.prometheus.rig import NO_SUCH_CORE, Rig, running_rig
from tests.prometheus.server import RATE_S, SCRAPE_S, Series, missing, until

pytestmark = [pytest.mark.prometheus, pytest.mark.node_red]

DASHBOARD = (
    Path(__file__).parents[2] / "deploy" / "grafana" / "dashboards" / "hilserver.json"
)
HOLD_S = 2.5
"""How long a stimulus lasts: more than the range of the rates."""

BEFORE_S = 1.0
"""What a stimulus is compared with."""

TRIES = 3

Act = Callable[[Rig], Awaitable[None]]


async def burn(rig: Rig) -> None:
    """Let the plant take several ticks' time."""
    rig.daemon.gate.take("page")
    rig.daemon.gate.write("page", {"lights.red": 255})
    await asyncio.sleep(HOLD_S)
    rig.daemon.gate.write("page", {"lights.red": 0})
    rig.daemon.gate.take("peer")


def drives(rig: Rig) -> bool:
    """Whether the robot drives; where a busy computer had stopped it, it is started again."""
    control = rig.daemon.control
    if control.state is State.SAFE:
        with contextlib.suppress(ControlRefused):
            control.reset()
            control.start()
    return control.state is State.RUNNING and rig.is_fresh


async def pause(rig: Rig) -> None:
    rig.daemon.control.pause()
    await asyncio.sleep(HOLD_S)
    rig.daemon.control.start()


async def command_out_of_range(rig: Rig) -> None:
    for _ in range(int(HOLD_S / 0.1)):
        rig.daemon.gate.write("page", {"measured.wheel.fl.speed_rpm": 1e6})
        await asyncio.sleep(0.1)


async def measure(rig: Rig) -> None:
    """A real robot that stands still beside the simulated one that drives."""
    for _ in range(int(HOLD_S / 0.1)):
        rig.daemon.gate.write("page", {"measured.wheel.fl.speed_rpm": 150.0})
        await asyncio.sleep(0.1)


async def inject_a_fault(rig: Rig) -> None:
    """Falsify the battery's voltage for a while."""
    rig.daemon.faults.inject(
        {"fault": "bias", "signal": "battery.voltage_v", "offset": 0.1}
    )
    await asyncio.sleep(HOLD_S)
    rig.daemon.faults.clear()


async def tune(rig: Rig) -> None:
    """Change a gain for a while."""
    parameters = rig.daemon.core.parameters
    await parameters.taken(
        parameters.apply(parameters.checked({"plant.controller.k_p": 12.0}))
    )
    await asyncio.sleep(HOLD_S)
    await parameters.taken(parameters.reset())


async def put_far_away(rig: Rig) -> None:
    rig.daemon.control.set_pose(100.0, 50.0, 1.0)
    await asyncio.sleep(HOLD_S)
    rig.daemon.control.set_pose(0.0, 0.0, 0.0)


async def slow_motion(rig: Rig) -> None:
    """Simulate at a tenth of real time: what a set-point changes is published ten times as late."""
    rig.daemon.control.set_speed(0.1)
    await asyncio.sleep(HOLD_S)
    rig.daemon.control.set_speed(1.0)


async def let_the_peer_stutter(rig: Rig) -> None:
    """Stop the controller for a quarter of a second, again and again."""
    assert rig.peer.process is not None
    for _ in range(20):
        rig.peer.process.send_signal(signal.SIGSTOP)
        await asyncio.sleep(0.25)
        rig.peer.process.send_signal(signal.SIGCONT)
        await asyncio.sleep(0.03)


async def make_garbage(rig: Rig) -> None:
    rings = []
    for _ in range(int(HOLD_S / 0.1)):
        for _ in range(20_000):
            ring: list[object] = []
            ring.append(ring)
            rings.append(ring)
        gc.collect()
        await asyncio.sleep(0.1)


async def ask_the_shield(rig: Rig) -> None:
    """A host asks at 50 Hz, for as long as a stimulus lasts."""
    host = os.open(rig.line, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    for _ in range(int(HOLD_S / 0.02)):
        os.write(host, request(ShieldCommand.SET_RPM))
        await asyncio.sleep(0.02)
    os.close(host)


async def fail_tasks(rig: Rig) -> None:
    """A task that should last fails as often as it begins; others that end by themselves fail."""

    async def fail() -> None:
        raise RuntimeError("on purpose")

    tasks = rig.daemon.core.tasks
    job = tasks.keep("failing", fail)
    for _ in range(int(HOLD_S / 0.1)):
        tasks.spawn(fail, "metrics request")
        await asyncio.sleep(0.1)
    await job.end()


async def recalibrate(rig: Rig) -> None:
    """The gap changes, windows are looked at, and a proposal waits after one that helped."""
    part = rig.daemon.part("recalibration")
    effect = {"yaw_rad": Quantity(0.06, 0.02, 3.0)}
    part.loop.proposal = Proposal(1, ("rotation_gain",), "", {}, effect=effect)
    part.loop.changed, part.figures.is_looking = "nav.x_m", True
    for _ in range(int(HOLD_S / 0.1)):
        part.figures.looks["named"] = part.figures.looks.get("named", 0) + 1
        part.figures.failures += 1
        part.figures.decisions["accepted"] += 1
        await asyncio.sleep(0.1)
    part.loop.proposal, part.loop.changed, part.figures.is_looking = None, None, False


async def fill_memory(rig: Rig) -> None:
    ballast = bytearray(64_000_000)
    ballast[::4096] = b"x" * len(ballast[::4096])
    await asyncio.sleep(HOLD_S)


async def kill_the_peer(rig: Rig) -> None:
    await rig.peer.kill()
    await until(lambda: rig.daemon.control.state is State.SAFE, 120, "it is missed")
    await asyncio.sleep(HOLD_S)


async def return_as_a_liar(rig: Rig) -> None:
    """The controller comes back and sends NaN with status Good."""
    rig.peer.flow = test_flow("lying")
    await rig.peer.start()
    status = rig.daemon.parts_of("peers")[0].status
    await until(
        lambda: sum(status.fault_counts.values()) > 0, 120, "the lie is noticed"
    )
    await asyncio.sleep(HOLD_S)
    await rig.peer.kill()
    rig.peer.flow = shipped_flow()


async def restart_the_peer_with_another_clock(rig: Rig) -> None:
    """The controller comes back, three seconds in the past."""
    shift = rig.peer.home / "shift.cjs"
    shift.write_text(
        "const now = Date.now; Date.now = () => now() - 3000;\n" + SHIFTED_DATE
    )
    rig.peer.environment["NODE_OPTIONS"] = f"--require {shift}"
    await rig.peer.start()
    await until(lambda: rig.is_fresh, 120, "the peer delivers again")
    status = rig.daemon.parts_of("peers")[0].status
    await until(lambda: status.clock_offset_s < -1.0, 120, "the other clock is noticed")
    rig.daemon.control.reset()
    rig.daemon.control.start()
    await asyncio.sleep(HOLD_S)


SHIFTED_DATE = """
const Real = Date;
globalThis.Date = class extends Real {
  constructor(...words) { super(...(words.length ? words : [Real.now()])); }
};
"""


async def restart_on_a_core_that_is_not_there(rig: Rig) -> None:
    await rig.daemon.__aexit__(None, None, None)
    rig.daemon = Daemon(rig.assembly(cpu=NO_SUCH_CORE))
    await rig.daemon.__aenter__()
    await until(lambda: rig.is_fresh, 120, "the peer delivers")
    await asyncio.sleep(HOLD_S)


def together(*acts: Act) -> Act:
    """What moves different panels may happen at the same time."""

    async def act(rig: Rig) -> None:
        await asyncio.gather(*(each(rig) for each in acts))

    act.__name__ = ", ".join(each.__name__ for each in acts)
    return act


@dataclass(frozen=True)
class Stimulus:
    """What is done, and the panels that have to show it: up, down, or appears (a new series).

    One that measures times is repeatable: a busy computer may have been as slow before it.
    `drives`: the robot does when it begins.
    """

    act: Act
    up: tuple[str, ...] = ()
    down: tuple[str, ...] = ()
    appears: tuple[str, ...] = ()
    repeatable: bool = False
    drives: bool = True


STIMULI = (
    Stimulus(
        burn,
        repeatable=True,
        up=(
            "Execution",
            "Overruns by cause",
            "Missed ticks",
            "Wake latency p99",
            "Wake latency by slice",
            "Jitter",
        ),
        down=(
            "Margin",
            "Margin of the plant",
            "Execution of the plant",
            "Wake latency of the plant",
        ),
    ),
    Stimulus(pause, appears=("State",)),
    Stimulus(measure, appears=("Model gap",)),
    Stimulus(
        together(command_out_of_range, inject_a_fault, tune, recalibrate),
        up=(
            "Refused values",
            "Active faults",
            "Parameters changed",
            "Proposals",
            "Looks",
            "Effect of a proposal",
        ),
    ),
    Stimulus(
        together(put_far_away, ask_the_shield, fail_tasks, fill_memory),
        up=(
            "Pose",
            "Samples of the navigation",
            "Found elsewhere",
            "Requests to the shield",
            "Lateness of the shield",
            "Memory",
        ),
        appears=("Tasks that run", "Ends that nobody asked for"),
    ),
    Stimulus(
        slow_motion, up=("End to end",), down=("Real-time factor",), repeatable=True
    ),
    Stimulus(
        let_the_peer_stutter, up=("Interval", "Round trip", "One way"), repeatable=True
    ),
    Stimulus(make_garbage, up=("Garbage collector",), repeatable=True),
    Stimulus(
        kill_the_peer,
        up=("Input ages",),
        down=("Peers connected", "Connected", "Wheel speeds"),
    ),
    Stimulus(return_as_a_liar, up=("Reconnects and faults",), drives=False),
    Stimulus(restart_the_peer_with_another_clock, down=("Clock offset",), drives=False),
    Stimulus(restart_on_a_core_that_is_not_there, appears=("Real-time audit",)),
)


def panels() -> list[tuple[str, list[str]]]:
    dashboard = json.loads(DASHBOARD.read_text(encoding="utf-8"))
    return [
        (panel["title"], [filled(target["expr"]) for target in panel["targets"]])
        for panel in dashboard["panels"]
        if panel["type"] != "row"
    ]


def filled(expression: str) -> str:
    for variable, value in (
        ("$__rate_interval", f"{RATE_S}s"),
        ("$__range", "60s"),
        ("$instance", ".+"),
    ):
        expression = expression.replace(variable, value)
    assert "$" not in expression
    return expression


def moved(how: str, before: Series, during: Series) -> bool:
    """Whether any series went beyond what it showed before the stimulus."""
    if how == "appears":
        return bool(during.keys() - before.keys())
    beyond = (
        (lambda new, old: max(new) > max(old))
        if how == "up"
        else (lambda new, old: min(new) < min(old))
    )
    return any(
        beyond(values, before.get(labels, [-math.inf if how == "up" else math.inf]))
        for labels, values in during.items()
    )


OF_ROS2 = {"ROS 2 neighbours", "Command of the ROS 2 host"}
"""This robot has no ROS 2; the metrics of these panels are in tests/io/ros2."""


def test_every_panel_has_a_stimulus() -> None:
    named = OF_ROS2 | {title for s in STIMULI for title in (*s.up, *s.down, *s.appears)}
    assert named == {title for title, _ in panels()}


async def queries_that_stand_still(
    rig: Rig, stimulus: Stimulus, begin_s: float, end_s: float
) -> list[str]:
    still = []
    for how in ("up", "down", "appears"):
        titles = getattr(stimulus, how)
        for title, expressions in panels():
            for expression in expressions if title in titles else ():
                ask = functools.partial(
                    asyncio.to_thread, rig.prometheus.range, expression
                )
                # A scrape that began before the stimulus may have read after it.
                before = await ask(begin_s - BEFORE_S - SCRAPE_S, begin_s - SCRAPE_S)
                during = await ask(begin_s + SCRAPE_S, end_s)
                if not moved(how, before, during):
                    name = stimulus.act.__name__
                    still.append(
                        f"{name}: {title} not {how}: {expression}: {before} {during}"
                    )
    return still


async def test_every_query_moves_under_its_stimulus(node_red, tmp_path) -> None:
    if sentence := missing():
        pytest.fail(sentence, pytrace=False)
    still: list[str] = []
    async with running_rig(node_red(shipped_flow()), tmp_path, blocks=True) as rig:
        await asyncio.sleep(RATE_S + BEFORE_S + SCRAPE_S)
        for stimulus in STIMULI:
            for _ in range(TRIES if stimulus.repeatable else 1):
                if stimulus.drives:
                    await until(lambda: drives(rig), 120, "the robot drives")
                begin_s = time.time()
                await stimulus.act(rig)
                standing = await queries_that_stand_still(
                    rig, stimulus, begin_s, time.time()
                )
                # what stood out hides what comes after it
                rig.daemon.control.reset_statistics()
                await asyncio.sleep(RATE_S + BEFORE_S + SCRAPE_S)
                if not standing:
                    break
            still += standing
        await rig.daemon.__aexit__(None, None, None)
    assert not still, "\n".join(still)
