"""Every metric moves under a stimulus of its own, on the live daemon, scraped over HTTP."""

import asyncio
import gc
import math
import re
import sys
import time
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import pytest_asyncio
from asyncua import ua
from structlog.testing import capture_logs

from hilserver.controller.nodes import demo_peer
from hilserver.daemon.metrics import METRICS
from hilserver.io.opcua_client.session import judge
from hilserver.monitoring.health_http import RENDER_EVERY_S
from tests.helpers.prom_diff import PromDiff, series_of_text
from tests.loopback.rig import (
    call,
    configuration,
    run_ticks,
    running,
    scrape,
    take,
    wait_until,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")

MOST_SERIES = 300
NO_STIMULUS = {
    "hil_model_gap",  # nothing measures the real robot here; see test_shadow
    "hil_model_gap_alarm",
    "hil_build_info",  # says what runs
    "hil_audit_ok",  # says what the computer is
    "hil_task_up",  # no task ends by itself; see test_tasks
    "hil_task_restarts_total",
    "hil_task_failures_total",
}


class ControllerProcess:
    """The embedded controller, to be killed and started again at one address."""

    def __init__(self):
        self.port = 0

    async def start(self):
        endpoint = f"opc.tcp://127.0.0.1:{self.port}/UA/NodeRedAgv"
        self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "hilserver.controller", "--endpoint", endpoint),
            stdout=asyncio.subprocess.PIPE,
        )
        line = (await self._process.stdout.readline()).decode()
        self.port = int(re.search(r":(\d+)/", line).group(1))

    @property
    def config(self):
        peer = demo_peer(f"opc.tcp://127.0.0.1:{self.port}/UA/NodeRedAgv", name="plc")
        return peer.model_dump(mode="json") | {
            "stale_after_ms": 300,
            "on_stale": "hold",
        }

    async def kill(self):
        self._process.kill()
        await self._process.communicate()


class Robot:
    """What the stimuli act on."""

    def __init__(self, daemon, client, controller):
        self.daemon, self.client, self.controller = daemon, client, controller

    @asynccontextmanager
    async def difference(self):
        diff = PromDiff(lambda: "")
        diff.before = series_of_text(await scrape(self.daemon))
        yield diff
        await self.scrape_again(diff)

    async def scrape_again(self, diff):
        """Scrape after the shortest time in which the server renders anew."""
        await asyncio.sleep(1.2 * RENDER_EVERY_S)
        diff.after = series_of_text(await scrape(self.daemon))

    async def value(self, name, **labels):
        await asyncio.sleep(1.2 * RENDER_EVERY_S)
        return series_of_text(await scrape(self.daemon)).get(
            (name, frozenset(labels.items()))
        )

    async def connected(self):
        return await self.value("hil_peer_connected", peer="plc") == 1.0


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def robot():
    controller = ControllerProcess()
    await controller.start()
    config = configuration(
        peers=[controller.config],
        blocks=[
            {
                "name": "busy",
                "function": "blocks.py:busy",
                "inputs": {"busy": "lights.blue"},
            },
        ],
        scheduler={
            "policy": "skip",
            "limits": {"single_overrun_ms": None, "consecutive_overruns": None},
            "realtime": {
                "priority": 0,
                "lock_memory": False,
                "hold_latency_target": False,
            },
        },
    )
    try:
        async with running(config, Path(__file__).parent) as (daemon, client):
            await wait_until(lambda: daemon.parts_of("peers")[0].status.connected)
            assert await take(client, "opcua") == "Good"
            await run_ticks(daemon, 200)  # the first hundred are warm-up: not counted
            yield Robot(daemon, client, controller)
    finally:
        await controller.kill()


async def busy(robot, amount):
    """Let the own block compute for some ten milliseconds times `amount` in one tick."""
    codes = await robot.client.write(
        ("lights.blue", 0, ua.VariantType.Byte), ("lights.red", 0, ua.VariantType.Byte)
    )
    await run_ticks(robot.daemon, 5)
    codes += await robot.client.write(("lights.blue", amount, ua.VariantType.Byte))
    assert codes == ["Good"] * 3
    await run_ticks(robot.daemon, 20)


async def ticks(robot):
    await run_ticks(robot.daemon, 200)


async def a_long_slice(robot):
    await busy(robot, 2)


async def a_blocked_loop(_robot):
    time.sleep(0.35)  # noqa: ASYNC251 - this is the fault
    await asyncio.sleep(0.05)


async def half_speed(robot):
    robot.daemon.control.set_speed(0.5)
    await run_ticks(robot.daemon, 700)


async def collected_garbage(_robot):
    gc.collect()


async def refused_write(robot):
    assert await robot.client.write_doubles(wheel__fl__setpoint_rpm=math.nan) == [
        "BadOutOfRange"
    ]


async def setpoint_change(robot):
    await robot.client.write_doubles(
        wheel__fl__setpoint_rpm=float(time.monotonic() % 50)
    )
    await run_ticks(robot.daemon, 60)
    await asyncio.sleep(0.05)


async def pause(robot):
    assert await call(robot.client, "Pause") == "Good"
    await robot.daemon.scheduler.wait_paused()


async def a_fault(robot):
    robot.daemon.faults.inject({"fault": "bias", "signal": "nav.x_m", "offset": 1.0})


async def another_gain(robot):
    parameters = robot.daemon.core.parameters
    await parameters.taken(
        parameters.apply(parameters.checked({"plant.controller.k_p": 0.6}))
    )


async def another_task(robot):
    robot.sleeper = asyncio.create_task(asyncio.sleep(2.0))


async def heartbeat(_robot):
    await asyncio.sleep(1.3)


async def _not(truth):
    return not await truth


async def lying_values(robot):
    """The link judges a sample that no sane controller sends."""
    node = next(iter(robot.daemon.config.peers[0].read))
    intake = robot.daemon.parts_of("peers")[0]._intake
    intake.receive(
        [(node, judge(ua.DataValue(ua.Variant(math.nan))))], time.monotonic_ns()
    )


async def recovered(robot):
    robot.daemon.control.set_speed(1.0)
    robot.daemon.faults.clear()
    await call(robot.client, "Start")


PEER = {"peer": "plc"}
STIMULI = [
    ("hil_wake_latency_seconds", "_count", {"slice": "plant"}, ticks, 100),
    ("hil_execution_seconds", "_sum", {"slice": "plant"}, a_long_slice, 0.005),
    ("hil_wake_jitter_seconds", "", {"slice": "publish"}, a_blocked_loop, None),
    (
        "hil_overruns_total",
        "",
        {"slice": "plant", "cause": "long_run"},
        a_long_slice,
        1,
    ),
    ("hil_missed_ticks_total", "", {"slice": "plant"}, a_long_slice, 1),
    ("hil_missed_ticks_total", "", {"slice": "publish"}, a_blocked_loop, 5),
    ("hil_missed_ticks_total", "", {"slice": "supervise"}, a_blocked_loop, 1),
    ("hil_realtime_factor", "", {}, half_speed, None),
    ("hil_gc_pause_seconds", "_count", {}, collected_garbage, 1),
    (
        "hil_rejected_values_total",
        "",
        {"source": "opcua", "reason": "not_finite"},
        refused_write,
        1,
    ),
    ("hil_end_to_end_seconds", "_count", {}, setpoint_change, 1),
    ("hil_state", "", {"state": "paused"}, pause, 1),
    ("hil_faults", "", {"kind": "injected"}, a_fault, 1),
    ("hil_parameters_changed", "", {}, another_gain, 1),
    ("hil_asyncio_tasks", "", {}, another_task, 1),
    ("hil_peer_round_trip_seconds", "_count", PEER, heartbeat, 1),
    ("hil_peer_interval_seconds", "_count", PEER, heartbeat, 10),
    ("hil_peer_one_way_latency_seconds", "_count", PEER, heartbeat, 10),
    ("hil_peer_faults_total", "", PEER | {"kind": "not_finite"}, lying_values, 1),
]
MOVED_ELSEWHERE = {
    "hil_margin_min_seconds",
    "hil_peer_connected",
    "hil_peer_reconnects_total",
    "hil_clock_offset_seconds",
    "hil_input_age_seconds",
    "hil_output",  # in tests/prometheus: the robot stands still here
    "hil_shield_requests_total",  # in tests/io/shield
    "hil_shield_lateness_seconds",
    "hil_ros2_participants",  # in tests/io/ros2
    "hil_ros2_endpoints_apart",
    "hil_ros2_command_held",
    "hil_ros2_command_age_seconds",
    "hil_observer_samples_total",  # in tests/daemon/test_observer.py
    "hil_observer_readmitted_total",
    "hil_recalibration_looks_total",  # in tests/monitoring
    "hil_recalibration_decisions_total",
    "hil_recalibration_failures_total",
    "hil_recalibration_proposal_open",
    "hil_recalibration_gap_changed",
    "hil_recalibration_looking",
    "hil_recalibration_effect_ratio",
}


@pytest.mark.parametrize(("name", "suffix", "labels", "stimulus", "least"), STIMULI)
async def test_the_stimulus_moves_the_metric(
    robot, name, suffix, labels, stimulus, least
):
    async def has_moved():
        await robot.scrape_again(diff)
        if (name + suffix, frozenset(labels.items())) not in diff.after:
            return False
        moved = diff[name + suffix, labels]
        return moved != 0 if least is None else moved >= least

    try:
        async with robot.difference() as diff:
            await stimulus(robot)
        await wait_until(has_moved)
    finally:
        await recovered(robot)


async def test_every_metric_has_its_stimulus():
    covered = {name for name, *_ in STIMULI} | MOVED_ELSEWHERE
    assert covered | NO_STIMULUS == {metric.name for metric in METRICS}


async def test_overruns_of_communication_slices_are_counted(robot):
    async with robot.difference() as diff:
        await a_blocked_loop(robot)
    for name in ("publish", "supervise"):
        causes = ("late_wake", "long_run")
        assert (
            sum(diff["hil_overruns_total", {"slice": name, "cause": c}] for c in causes)
            >= 1
        )


async def test_the_margin_falls_below_zero_with_a_long_slice_and_starts_anew_by_reset(
    robot,
):
    assert await call(robot.client, "ResetStatistics") == "Good"
    await a_long_slice(robot)
    assert await robot.value("hil_margin_min_seconds", slice="plant") < -0.001
    before = await robot.value("hil_overruns_total", slice="plant", cause="long_run")
    assert await call(robot.client, "ResetStatistics") == "Good"
    await run_ticks(robot.daemon, 50)
    assert await robot.value("hil_margin_min_seconds", slice="plant") > -0.5
    after = await robot.value("hil_overruns_total", slice="plant", cause="long_run")
    assert after >= before, "a total never falls"


async def test_the_log_line_names_the_slice_as_the_cause(robot):
    wanted = {"kind": "long_run", "slice": "plant", "cause": "slice"}.items()

    async def is_named():
        # a busy computer may stop the thread meanwhile: another cause
        await a_long_slice(robot)
        return any(wanted <= line.items() for line in lines)

    with capture_logs() as lines:
        await wait_until(is_named, 60.0)


async def test_a_killed_peer_is_not_connected_grows_old_and_comes_back(robot):
    assert await robot.value("hil_peer_connected", **PEER) == 1.0
    assert await take(robot.client, "peer") == "Good"
    await wait_until(lambda: robot.daemon.gate.age_s("peer:plc") is not None)
    async with robot.difference() as diff:
        await robot.controller.kill()
        await wait_until(lambda: _not(robot.connected()))
        old = await robot.value("hil_input_age_seconds", source="peer:plc")
        await asyncio.sleep(0.3)
        assert (
            await robot.value("hil_input_age_seconds", source="peer:plc") >= old + 0.3
        )
        await robot.controller.start()
        await wait_until(robot.connected)
        offset = ("hil_clock_offset_seconds", frozenset(PEER.items()))
        await wait_until(
            lambda: (
                robot.daemon.parts_of("peers")[0].status.clock_offset_s
                != diff.before[offset]
            )
        )
        await wait_until(lambda: robot.daemon.gate.age_s("peer:plc") < 0.3)
    assert diff["hil_peer_reconnects_total", PEER] == 1
    assert diff["hil_clock_offset_seconds", PEER] != 0
    assert abs(diff.after[offset]) < 0.5, "both clocks are the same one"
    assert await take(robot.client, "opcua") == "Good"


async def test_the_build_and_the_audit_are_told(robot):
    found = series_of_text(await scrape(robot.daemon))
    (labels,) = [dict(labels) for name, labels in found if name == "hil_build_info"]
    assert labels["config"] == robot.daemon.config.sha256
    items = {dict(labels)["item"] for name, labels in found if name == "hil_audit_ok"}
    assert items == {item.name for item in robot.daemon.audit}


async def test_health_and_readiness(robot):
    await run_ticks(robot.daemon, 300)
    assert "ok" in (await scrape(robot.daemon, "/healthz")).lower()
    await wait_until(lambda: robot.daemon.supervision.first_ticks_met)
    assert await scrape(robot.daemon, "/readyz")


async def test_no_more_series_than_agreed(robot):
    lines = (await scrape(robot.daemon)).splitlines()
    series = [line for line in lines if line and not line.startswith("#")]
    assert 100 < len(series) <= MOST_SERIES
