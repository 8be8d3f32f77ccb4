"""Commands are leases: who has control drives by his row, and what is not renewed lapses."""

import contextlib
import time
from types import SimpleNamespace

import pytest

from hilserver.config.root import Config
from hilserver.core.control import Control
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.daemon.supervision import Supervision
from hilserver.image import Row
from hilserver.plant.layout import N_SETPOINTS
from hilserver.signals import State

RAMP_TICKS = 100
LIMIT_TICKS = 300
RIGHT, LEFT = "wheel.fr.setpoint_rpm", "wheel.fl.setpoint_rpm"
PEER = {"name": "plc", "endpoint": "opc.tcp://127.0.0.1:9/", "read": {"ns=1;s=a": LEFT}}


@contextlib.asynccontextmanager
async def robot(on_stale="ramp", **control):
    peer = PEER | {"on_stale": on_stale, "stale_after_ms": LIMIT_TICKS}
    sections = {
        "plant": {"safe_ramp_s": RAMP_TICKS * 1e-3},
        "page": {"deadman_ms": LIMIT_TICKS},
        "control": control,
        "peers": [peer],
    }
    config = Config.model_validate(sections)
    async with build(assemble_config(config)) as core:
        yield core


def now(core, name=LEFT):
    return core.image.latest().values[core.table.slot(name)]


def series(core, first, name=LEFT):
    slot = core.table.slot(name)
    return [core.image.frame(i).values[slot] for i in range(first, core.image.head)]


async def drive(core, source, rpm, ticks=1):
    """Let `source` say it anew in every tick, as one that is alive does."""
    for _ in range(ticks):
        core.gate.write(source, {LEFT: rpm})
        await core.scheduler.advance(1)


async def test_who_takes_control_begins_at_zero_and_nothing_of_before_is_left():
    async with robot() as core:
        await drive(core, "peer:plc", 40.0, 2 * RAMP_TICKS)
        core.gate.take("opcua")
        first = core.image.head
        await core.scheduler.advance(2 * RAMP_TICKS)
        seen = series(core, first)
        assert seen[0] == pytest.approx(40.0 * (1 - 1 / RAMP_TICKS))
        assert seen == sorted(seen, reverse=True)
        assert seen[RAMP_TICKS - 1] == seen[-1] == 0.0
        core.gate.write("opcua", {"control.mode": 1, "twist.linear_m_s": 0.1})
        await core.scheduler.advance(1)
        assert (now(core, "control.mode"), now(core, "twist.linear_m_s")) == (1.0, 0.1)
        core.gate.take("peer")
        await core.scheduler.advance(2 * RAMP_TICKS)
        assert (now(core, "control.mode"), now(core)) == (0.0, 40.0), (
            "its mode, its newest row"
        )
        assert now(core, "twist.linear_m_s") == 0.0


async def test_a_peer_that_offers_while_another_drives_is_heard_when_it_gets_control_back():
    async with robot() as core:
        core.gate.take("page")
        assert core.gate.write("peer:plc", {LEFT: 25.0}) == {LEFT: "not_in_control"}
        core.gate.write("peer:plc", {"lights.red": 200})
        await core.scheduler.advance(10)
        assert now(core) == now(core, "lights.red") == 0.0
        core.gate.take("peer")
        await core.scheduler.advance(RAMP_TICKS)
        assert now(core) == 25.0


async def test_what_a_client_wrote_without_control_never_counts():
    async with robot() as core:
        core.gate.write("opcua", {LEFT: 25.0})
        core.gate.take("opcua")
        await core.scheduler.advance(3 * RAMP_TICKS)
        assert now(core) == 0.0


@pytest.mark.parametrize("on_stale", ["hold", "zero", "ramp"])
async def test_a_command_that_nobody_renews_lapses_in_the_step(on_stale):
    async with robot(on_stale) as core:
        await drive(core, "peer:plc", 40.0, 5)
        first = core.image.head
        await core.scheduler.advance(LIMIT_TICKS - 1)
        assert set(series(core, first)) == {40.0}
        await core.scheduler.advance(2)
        expected = {"hold": (40.0, 0.0), "zero": (0.0, 0.0), "ramp": (40.0, 2.0)}
        assert (now(core), now(core, "internal.command")) == expected[on_stale]
        named = [lapse.source for lapse in core.gate.leases.lapses()]
        assert named == ([] if on_stale == "hold" else ["peer:plc"])
        assert list(core.gate.leases.lapses()) == [], "each once"


@pytest.mark.parametrize("on_stale", ["hold", "zero", "ramp"])
async def test_an_offer_that_has_lapsed_is_not_driven_by_who_gets_control_back(
    on_stale,
):
    async with robot(on_stale) as core:
        await drive(core, "peer:plc", 40.0)
        core.gate.take("opcua")
        await core.scheduler.advance(2 * LIMIT_TICKS)
        core.gate.take("peer")
        await core.scheduler.advance(2 * RAMP_TICKS)
        assert now(core) == 0.0 or now(core, "internal.command") == 2.0


async def test_without_a_ramp_the_drive_is_disabled_at_once():
    async with robot(source="opcua") as core:
        core.image.control.safe_ramp = 0
        core.image.control.state = 3
        await core.scheduler.advance(2)
        assert now(core, "drive.enable") == 0.0


async def test_a_lapse_says_how_long_the_event_loop_had_been_silent():
    async with robot("zero") as core:
        core.watch_communication(10_000)
        await drive(core, "peer:plc", 40.0)
        for _ in range(LIMIT_TICKS + 5):
            core.image.control.heartbeat += 1
            await core.scheduler.advance(1)
        (lapse,) = core.gate.leases.lapses()
        assert (lapse.stalled_ticks, lapse.waited_ms) == (0, 0.0)
        await drive(core, "peer:plc", 40.0)
        await core.scheduler.advance(LIMIT_TICKS + 5)
        (lapse,) = core.gate.leases.lapses()
        assert lapse.stalled_ticks >= LIMIT_TICKS


async def test_what_is_renewed_goes_on_also_without_a_new_value():
    async with robot() as core:
        await drive(core, "peer:plc", 40.0)
        for _ in range(5):
            await core.scheduler.advance(LIMIT_TICKS - 1)
            core.gate.leases.renew("peer:plc", 0)
        await core.scheduler.advance(1)
        assert now(core) == 40.0


async def test_a_command_lapses_from_when_it_came_in():
    async with robot("zero") as core:
        core.gate.write("peer:plc", {LEFT: 40.0}, renews=False)
        core.image.push(
            core.gate.leases.renewal("peer:plc", -(LIMIT_TICKS - 50) * 1_000_000)
        )
        await core.scheduler.advance(LIMIT_TICKS)
        assert series(core, 0).count(40.0) == 51
        assert [lapse.source for lapse in core.gate.leases.lapses()] == ["peer:plc"]


@pytest.mark.parametrize("on_stale", ["zero", "ramp"])
async def test_what_came_in_before_a_standstill_of_ours_is_never_driven(on_stale):
    async with robot(on_stale) as core:
        said = []
        control = SimpleNamespace(
            speed=1.0, enter_safe=lambda why, **_: said.append(why), before_reset=[]
        )
        Supervision(core, control)
        core.gate.leases.now_ns = time.monotonic_ns
        await core.scheduler.advance(10)
        long_ago_ns = time.monotonic_ns() - (LIMIT_TICKS + 1) * 1_000_000
        core.gate.write("peer:plc", {LEFT: 40.0}, commanded_ns=long_ago_ns)
        await core.scheduler.advance(10)
        assert on_stale == "ramp" or set(series(core, 0)) == {0.0}
        assert (now(core, "internal.command") == 2.0) == (on_stale == "ramp")
        control.before_reset[0]()
        assert on_stale == "zero" or said[0].startswith(
            "the daemon's event loop was blocked for"
        )
        core.gate.leases.now_ns = lambda: 0
        core.gate.write("peer:plc", {LEFT: 40.0}, commanded_ns=long_ago_ns)
        await core.scheduler.advance(10)
        assert on_stale == "ramp" or now(core) == 40.0, (
            "simulated time does not pass meanwhile"
        )


async def test_a_peer_that_lacks_an_input_does_not_renew():
    async with robot("zero") as core:
        for _ in range(LIMIT_TICKS + 5):
            core.gate.write("peer:plc", {LEFT: 40.0}, renews=core.scheduler.tick < 3)
            await core.scheduler.advance(1)
        assert [lapse.action for lapse in core.gate.leases.lapses()] == ["zero"]


async def test_the_dead_man_of_the_page_ends_what_it_holds_and_nothing_of_others():
    async with robot(source="page") as core:
        await drive(core, "page:1", 40.0)
        await core.scheduler.advance(LIMIT_TICKS + 1)
        assert now(core) == 0.0
        core.gate.take("opcua")
        core.gate.write("opcua", {LEFT: 10.0})
        await core.scheduler.advance(5 * LIMIT_TICKS)
        assert now(core) == 10.0


async def test_of_one_kind_only_the_source_with_a_limit_lapses():
    async with robot(source="opcua") as core:
        await drive(core, "opcua:teleop", 40.0)
        await core.scheduler.advance(LIMIT_TICKS + 1)
        assert now(core) == 0.0


async def test_two_sources_of_one_kind_never_mix():
    async with robot(source="page") as core:
        await drive(core, "page:1", 40.0, 3)
        core.gate.write("page:foxglove", {"wheel.rl.setpoint_rpm": 20.0})
        await core.scheduler.advance(2 * RAMP_TICKS)
        assert (now(core), now(core, "wheel.rl.setpoint_rpm")) == (0.0, 20.0)


async def test_a_restored_state_and_a_reset_drive_by_nothing_of_before(tmp_path):
    async with robot(source="opcua") as core:
        await drive(core, "opcua", 40.0, 3)
        core.snapshots.reset()
        first = core.image.head
        await core.scheduler.advance(20)
        assert set(series(core, first)) == {0.0}
        await drive(core, "opcua", 30.0)
        assert now(core) == 30.0


def fill_queue(core):
    while core.image.push([Row(core.table.slot("lights.red"), 1.0)]):
        pass


def supervised(core):
    control = Control(
        core.table, core.image, core.gate, core.events, core.scheduler, core.snapshots
    )
    control.started()
    return control, Supervision(core, control)


def let_command(core, client, *, took_control):
    if took_control:
        core.gate.request("opcua", "opcua", client)
    else:
        core.gate.commanded(range(N_SETPOINTS), client)


@pytest.mark.parametrize("took_control", [True, False])
async def test_a_client_that_leaves_while_the_queue_is_full_drives_no_longer(
    took_control,
):
    async with robot(source="opcua") as core:
        control, supervision = supervised(core)
        let_command(core, client := object(), took_control=took_control)
        await drive(core, "opcua", 40.0, 3)
        fill_queue(core)
        core.gate.gone(client)
        await core.scheduler.advance(1)
        supervision.run()
        await core.scheduler.advance(2 * RAMP_TICKS)
        assert now(core) == 0.0
        assert core.gate.owner == ("nobody" if took_control else "opcua")
        assert control.state is State.RUNNING


@pytest.mark.parametrize("took_control", [True, False])
async def test_a_queue_that_stays_full_after_a_client_has_left_is_the_safe_state(
    took_control,
):
    async with robot(source="opcua") as core:
        control, supervision = supervised(core)
        let_command(core, client := object(), took_control=took_control)
        fill_queue(core)
        core.gate.gone(client)
        control.pause()
        supervision.run()
        assert control.state is State.PAUSED, "nothing moves in a pause"
        control.start()
        supervision.run()
        assert control.state is State.SAFE
        assert control.reason.startswith("the input queue is full")


async def test_who_commands_after_a_client_that_left_is_not_ended_with_it():
    async with robot(source="opcua") as core:
        _, supervision = supervised(core)
        let_command(core, client := object(), took_control=False)
        fill_queue(core)
        core.gate.gone(client)
        await core.scheduler.advance(1)
        core.gate.commanded(range(N_SETPOINTS), object())
        await drive(core, "opcua", 30.0)
        supervision.run()
        await core.scheduler.advance(2 * RAMP_TICKS)
        assert now(core) == 30.0


async def test_a_full_queue_refuses_to_hand_control_over():
    async with robot() as core:
        fill_queue(core)
        with pytest.raises(Exception, match="input queue is full"):
            core.gate.take("opcua")
        assert core.gate.owner == "peer"


@pytest.mark.parametrize("fallback", ["nobody", "before"])
async def test_when_the_holder_is_gone_control_goes_on_as_configured(fallback):
    async with robot(fallback=fallback) as core:
        await drive(core, "peer:plc", 40.0)
        holder = object()
        core.gate.request("opcua", "opcua", holder)
        core.gate.write("opcua", {LEFT: 10.0})
        core.gate.gone(object())
        assert core.gate.owner == "opcua", "somebody else left"
        core.gate.gone(holder)
        assert core.gate.owner == {"nobody": "nobody", "before": "peer"}[fallback]
        await drive(core, "peer:plc", 40.0, 3 * RAMP_TICKS)
        assert now(core) == {"nobody": 0.0, "before": 40.0}[fallback]


async def test_after_a_stop_nobody_drives_by_himself():
    async with robot(fallback="before") as core:
        holder = object()
        core.gate.request("opcua", "opcua", holder)
        core.gate.may_fall_back = False
        core.gate.gone(holder)
        assert core.gate.owner == "nobody"
