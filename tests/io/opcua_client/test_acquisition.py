"""When a subscription is too slow, and how cycles keep their grid."""

import asyncio

import pytest

from hilserver.core.refusal import Refusal
from hilserver.io.opcua_client.acquisition import too_many_missed, too_slow
from hilserver.io.opcua_client.subscription import Grant
from hilserver.period import every
from tests.io.opcua_client.conftest import make_harness, peer_config, wait_until

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest.mark.parametrize(
    ("publishing", "sampling", "says"),
    [
        (50, 0, ""),  # Node-RED's own nodes with MinimumSamplingInterval 0
        (50, 50, ""),  # asyncua: says so, but reports every change
        (50, 500, "samples every 500 ms"),  # Node-RED's addVariable
        (100, 50, "publishes every 100 ms instead of 50"),  # open62541's default
        (100, 250, "samples every 250 ms"),
    ],
)
async def test_what_is_too_slow(publishing, sampling, says):
    reason = too_slow(Grant(publishing, sampling), publishing_ms=50, poll_ms=10)
    assert (says in reason) if says else reason == ""


@pytest.mark.parametrize(
    ("received", "missed", "slow"),
    [(0, 0, False), (95, 5, False), (94, 6, True), (1, 99, True)],
)
async def test_too_many_missed(received, missed, slow):
    assert bool(too_many_missed(received, missed)) == slow


async def test_late_cycles_are_skipped_not_made_up_for():
    runs, skipped = 0, 0

    async def cycle() -> None:
        nonlocal runs
        runs += 1
        if runs == 1:
            await asyncio.sleep(0.055)
        if runs == 3:
            raise LookupError

    def skip(count: int) -> None:
        nonlocal skipped
        skipped += count

    with pytest.raises(LookupError):
        await every(0.01, cycle, skip)
    assert skipped >= 4


async def test_a_counter_that_leaves_numbers_out_ends_the_subscription(peer):
    """The peer grants what was asked for and yet loses samples: observed, not granted."""
    harness = make_harness(peer_config(peer.port))
    await harness.link.start()
    try:
        await wait_until(lambda: harness.status.mode == "subscribe")
        for number in range(0, 2000, 10):
            await peer.set("seq", number)
            await asyncio.sleep(0.02)
            if harness.status.mode == "poll":
                break
        assert harness.status.mode == "poll"
        assert "sequence numbers did not arrive" in harness.status.mode_reason
    finally:
        await harness.link.stop()


async def test_a_failing_gate_ends_the_session_instead_of_being_swallowed(peer):
    harness = make_harness(peer_config(peer.port, mode="subscribe"))
    broken = True
    write = harness.gate.write

    def failing(source, values, **_):
        if broken:
            raise RuntimeError("the gate is broken")
        return write(source, values)

    harness.gate.write = failing
    await harness.link.start()
    try:
        await wait_until(
            lambda: harness.status.last_error == "RuntimeError: the gate is broken"
        )
        broken = False
        await peer.cycle(rpm_set_FL=8.0)
        await wait_until(
            lambda: harness.gate.latest.get("wheel.fl.setpoint_rpm") == 8.0
        )
    finally:
        await harness.link.stop()


async def test_while_another_commands_the_peer_goes_on_offering(peer):
    harness = make_harness(peer_config(peer.port, mode="poll"))
    harness.gate.refuse = dict.fromkeys(
        [*harness.link.config.inputs, "input.sequence"], Refusal.NOT_IN_CONTROL
    )
    await harness.link.start()
    task = asyncio.create_task(peer.run())
    try:
        await wait_until(lambda: harness.status.sequence_received >= 30)
        assert len(harness.gate.groups) >= 30
        assert harness.status.faults == {}
        harness.gate.refuse = {}
        await wait_until(lambda: "wheel.fl.setpoint_rpm" in harness.gate.latest)
    finally:
        task.cancel()
        await harness.link.stop()
