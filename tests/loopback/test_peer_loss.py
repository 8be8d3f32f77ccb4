"""A peer that falls silent, comes back, or lies; two peers; who has control meanwhile."""

import contextlib
import math

import pytest
import pytest_asyncio
from asyncua import ua

from hilserver.core.events import EventKind
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.errors import ControlRefused
from hilserver.signals import State
from hilserver.status import UNCERTAIN_LAST_USABLE_VALUE
from tests.loopback.rig import (
    Peer,
    call,
    column,
    configuration,
    frames,
    inbox,
    newest,
    run_ticks,
    running,
    scrape,
    take,
    wait_until,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")

STALE_AFTER_S = 0.2
SAFE_RAMP_S = 0.2
SETTLING_TICKS = 150
"""By how much the wheels stand later than the ramp has ended."""


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plc():
    async with Peer() as peer:
        yield peer


@pytest_asyncio.fixture(loop_scope="module")
async def peer(plc):
    plc.set(0.0, 0.0, 0.0, 0.0)
    plc.values["enable"] = True
    plc.is_silent = False
    return plc


def config(*peers, **sections):
    return configuration(
        peers=list(peers), plant={"safe_ramp_s": SAFE_RAMP_S}, **sections
    )


def robot(*peers):
    return running(config(*peers))


def robot_without_server(*peers):
    """A daemon that starts sooner."""
    return Daemon(assemble_config(config(*peers, opcua={"enabled": False})))


def speed(daemon, wheel="fl"):
    if daemon.image.head == 0:
        return 0.0  # no frame yet
    return newest(daemon, f"wheel.{wheel}.speed_rpm")


async def driven(daemon, peer, rpm=50.0):
    """Wait until the wheels follow the peer; one that a busy computer held up needs a reset."""
    peer.set(rpm, rpm, -rpm, -rpm)

    def follows():
        if daemon.control.state is State.SAFE:
            with contextlib.suppress(ControlRefused):
                daemon.control.reset()
                daemon.control.start()
        return abs(speed(daemon) - rpm) < 1.0

    await wait_until(follows)


def status(daemon, name):
    return int(daemon.image.latest().status[daemon.table.slot(name)])


async def test_ramp_is_the_safe_state_until_the_peer_is_back_and_reset_is_called(peer):
    async with (
        robot(peer.config(on_stale="ramp")) as (daemon, client),
        inbox(client) as box,
    ):
        await driven(daemon, peer)
        first = daemon.image.head
        peer.is_silent = True
        await wait_until(lambda: daemon.control.state is State.SAFE)
        await run_ticks(daemon, 600)
        history = list(frames(daemon, first))
        slot = daemon.table.slot
        speeds = [abs(f.values[slot("wheel.fl.speed_rpm")]) for f in history]
        begin = [f.values[slot("internal.command")] for f in history].index(2.0)
        # in ticks: what the wheels do hangs on no clock
        ramp = round(SAFE_RAMP_S * 1e3)
        assert speeds[begin] > 45.0
        assert speeds[begin + ramp // 2] > 15.0, "a ramp, not a stop"
        assert max(speeds[begin + ramp + SETTLING_TICKS :]) < 1.0
        told = [
            e.monotonic_ns
            for e in daemon.events.recent
            if e.kind is EventKind.PEER_LOST
        ]
        assert told[-1] - peer.offered_ns > STALE_AFTER_S * 1e9, (
            "called silent too soon"
        )
        assert status(daemon, "wheel.fl.setpoint_rpm") == UNCERTAIN_LAST_USABLE_VALUE
        await wait_until(
            lambda: box.has("peer_lost") and box.has("safe_state", "silent")
        )
        await wait_until(lambda: newest(daemon, "drive.enable") == 0.0)

        refused = await client.call("Reset")
        assert refused.StatusCode.name == "BadInvalidState"
        assert daemon.control.state is State.SAFE
        peer.set(0.0, 0.0, 0.0, 0.0)
        peer.is_silent = False
        await wait_until(lambda: box.has("peer_restored", "fresh"))
        await wait_until(lambda: status(daemon, "wheel.fl.setpoint_rpm") == 0)
        assert daemon.control.state is State.SAFE, "only Reset ends the safe state"
        first = daemon.image.head

        async def reset():  # refused for as long as the peer is late once more
            return await call(client, "Reset") == "Good"

        await wait_until(reset)
        await run_ticks(daemon, 400)
        assert max(map(abs, column(daemon, "wheel.fl.speed_rpm", first))) < 1.0, (
            "old set-point"
        )
        peer.set(30.0, 30.0, -30.0, -30.0)
        await run_ticks(daemon, 400)
        assert newest(daemon, "control.waits_for_start") == 1.0
        assert max(map(abs, column(daemon, "wheel.fl.speed_rpm", first))) < 1.0, (
            "without Start"
        )
        assert await call(client, "Start") == "Good"
        await driven(daemon, peer, 30.0)


async def test_zero_stops_at_once_and_the_peer_drives_on_when_it_is_back(peer):
    async with robot_without_server(peer.config(on_stale="zero")) as daemon:
        await driven(daemon, peer)
        first = daemon.image.head
        peer.is_silent = True
        await wait_until(lambda: speed(daemon) < 1.0)
        setpoints = column(daemon, "wheel.fl.setpoint_rpm", first)
        assert set(setpoints) == {50.0, 0.0}, "no ramp"
        assert set(column(daemon, "internal.command", first)) == {0.0}
        assert daemon.control.state is State.RUNNING
        peer.is_silent = False
        await driven(daemon, peer)


async def test_hold_drives_on_and_says_so(peer):
    async with (
        robot(peer.config(on_stale="hold")) as (daemon, client),
        inbox(client) as box,
    ):
        await driven(daemon, peer)
        first = daemon.image.head
        peer.is_silent = True
        await wait_until(lambda: box.has("peer_lost", "on_stale is hold"))
        await run_ticks(daemon, 300)
        assert set(column(daemon, "wheel.fl.setpoint_rpm", first)) == {50.0}

        async def shows_it():  # a loop that is held up may have said the same before, and gone on
            data = await client.data_value("wheel.fl.setpoint_rpm")
            return (data.Value.Value, data.StatusCode.name) == (
                50.0,
                "UncertainLastUsableValue",
            )

        await wait_until(shows_it)
        assert daemon.control.state is State.RUNNING


async def test_a_silent_peer_without_control_disturbs_nobody(peer):
    async with (
        robot(peer.config(on_stale="ramp")) as (daemon, client),
        inbox(client) as box,
    ):
        await driven(daemon, peer)
        assert await take(client, "opcua") == "Good"
        kind = ua.VariantType.Double
        codes = await client.write(
            ("wheels.setpoints_rpm", [10.0, 10.0, -10.0, -10.0], kind)
        )
        assert codes == ["Good"]
        await run_ticks(daemon, 1200)  # down to zero, and up again
        first = daemon.image.head
        peer.is_silent = True
        await wait_until(lambda: box.has("peer_lost"))
        await run_ticks(daemon, 200)
        assert set(column(daemon, "wheel.fl.setpoint_rpm", first)) == {10.0}
        assert status(daemon, "wheel.fl.setpoint_rpm") == 0
        assert daemon.control.state is State.RUNNING

        assert await take(client, "peer") == "Good"
        await wait_until(lambda: daemon.control.state is State.SAFE)
        assert await call(client, "Reset") == "BadInvalidState"
        assert await take(client, "opcua") == "Good"
        assert await call(client, "Reset") == "Good", (
            "the silent peer has no control any more"
        )
        await run_ticks(daemon, 50)
        assert daemon.control.state is State.RUNNING


async def test_nan_with_status_good_never_reaches_the_plant(peer):
    async with (
        robot(peer.config(on_stale="ramp")) as (daemon, client),
        inbox(client) as box,
    ):
        await driven(daemon, peer)
        first = daemon.image.head
        peer.values["rpm_set_FL"] = math.nan
        await wait_until(lambda: box.has("peer_fault", "rpm_set_FL"))
        await wait_until(lambda: daemon.control.state is State.SAFE)
        await run_ticks(daemon, 400)
        inputs = [
            daemon.table.slot(s.name)
            for s in daemon.table
            if s.writable and not s.is_array
        ]
        for frame in frames(daemon, first):
            assert all(map(math.isfinite, frame.values[inputs]))
            assert math.isfinite(frame.values[daemon.table.slot("wheel.fl.speed_rpm")])
        assert set(column(daemon, "wheel.fl.setpoint_rpm", first)) == {50.0}
        name = 'hil_peer_faults_total{kind="not_finite",peer="plc"}'
        assert any(
            line.startswith(name) for line in (await scrape(daemon)).splitlines()
        )
        assert any(e.SourceName == "plc" for e in box.events if e.Kind == "peer_fault")


async def test_of_two_silent_peers_both_have_to_come_back_before_reset(peer):
    left = ("rpm_set_FL", "rpm_set_RL")
    every = peer.config()["read"]
    right = {node: name for node, name in every.items() if node.endswith(("FR", "RR"))}
    async with (
        Peer(left) as other,
        robot_without_server(
            other.config("left"), peer.config("right", read=right)
        ) as daemon,
    ):
        other.values |= dict.fromkeys(left, 40.0)
        peer.set(0.0, 0.0, -40.0, -40.0)
        await wait_until(lambda: speed(daemon) > 39.0 and speed(daemon, "rr") < -39.0)
        other.is_silent = True
        await wait_until(lambda: daemon.control.state is State.SAFE)
        assert daemon.control.reason == "peer 'left' is silent"
        peer.is_silent = True
        await wait_until(lambda: daemon.parts_of("peers")[1].status.stale)
        other.is_silent = False
        await wait_until(lambda: not daemon.parts_of("peers")[0].status.stale)
        with pytest.raises(ControlRefused, match="'right' is silent"):
            daemon.control.reset()
        peer.is_silent = False
        await wait_until(lambda: not daemon.parts_of("peers")[1].status.stale)
        daemon.control.reset()
        daemon.control.start()
        await wait_until(lambda: speed(daemon) > 39.0 and speed(daemon, "rr") < -39.0)
