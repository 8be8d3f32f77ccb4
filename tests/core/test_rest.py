"""Reset alone moves nothing: a hand has to be at rest first, a controller waits for Start."""

import pytest

from hilserver.core.events import EventBus
from hilserver.core.rest import Interlock
from tests.core.test_inputs import latched
from tests.fakes import ManualClock, latch_inputs, make_gate, make_image, make_table

HELD = {"control.mode": 1, "twist.linear_m_s": 0.4, "twist.angular_rad_s": 0.0}
AT_REST = HELD | {"twist.linear_m_s": 0.0}
REFUSED = dict.fromkeys(HELD, "not_at_rest")


@pytest.fixture
def world():
    table, clock, events = make_table(), ManualClock(), EventBus()
    image = make_image(table, queue_rows=64)
    gate = make_gate(table, image, events, owner="page", monotonic_ns=clock)
    yield gate, image, events, clock
    image.close()


@pytest.mark.parametrize("source", ["page:3", "page:foxglove", "opcua:teleop"])
def test_a_hand_that_is_held_over_a_reset_moves_nothing_until_it_was_at_rest(
    world, source
):
    """Before, the robot drove on by itself as soon as somebody pressed Reset."""
    gate, image, events, clock = world
    gate.take(source.partition(":")[0])
    assert gate.write(source, HELD) == {}
    gate.end()
    told = len(events.recent)
    for _ in range(50):
        clock.pass_s(0.05)
        assert gate.write(source, HELD) == REFUSED
    assert latched(image, "twist.linear_m_s") == 0.0
    assert len(events.recent) == told + 1  # it is told once
    assert "let go first" in events.recent[-1].message
    assert gate.write(source, AT_REST) == {}
    assert gate.write(source, HELD) == {}
    assert latched(image, "twist.linear_m_s") == 0.4


def test_a_hand_was_not_at_rest_by_what_it_sent_before_or_without_control(world):
    gate, image, _, clock = world
    gate.write("page:1", HELD)
    gate.write("page:1", AT_REST)
    came_ns = clock()
    clock.pass_s(1.0)
    gate.end()
    gate.write("page:1", AT_REST, received_ns=came_ns)  # read afterwards
    gate.take("opcua")
    gate.write("page:1", AT_REST)
    gate.take("page")
    assert gate.write("page:1", HELD) == REFUSED
    assert gate.write("page:2", AT_REST) == {}  # another one
    assert gate.write("page:1", HELD) == REFUSED
    assert latched(image, "twist.linear_m_s") == 0.0


def test_a_terminal_lets_go_for_itself_only(world):
    """Before, all terminals were one: another one at rest let a held stick drive after a Reset."""
    gate, image, _, _ = world
    gate.take("opcua")
    assert gate.write("opcua:teleop:1", HELD) == {}
    gate.end()
    assert gate.write("opcua:teleop:2", AT_REST) == {}
    assert gate.write("opcua:teleop:1", HELD) == REFUSED
    assert latched(image, "twist.linear_m_s") == 0.0


def test_foxglove_sends_nothing_at_rest(world):
    gate, _, _, clock = world
    gate.end()
    clock.pass_s(0.5)
    assert gate.write("page:foxglove", HELD) == REFUSED
    clock.pass_s(1.1)
    assert gate.write("page:foxglove", HELD) == {}


def test_lights_and_measured_values_need_no_rest(world):
    gate, _, _, _ = world
    gate.end()
    assert gate.write("page:1", {"lights.command": 2, "measured.pose.x_m": 1.0}) == {}


@pytest.mark.parametrize(("by_hand", "refused"), [(True, True), (False, False)])
def test_a_gamepad_of_ros_2_is_a_hand_and_a_controller_is_none(world, by_hand, refused):
    gate, _, _, _ = world
    gate.take("ros2")
    gate.end()
    assert bool(gate.write("ros2", HELD, by_hand=by_hand)) is refused


AUTOMATIC = ("peer:a", "opcua", "ros2", "shield", "peer:s7", "peer:edge")


@pytest.fixture(params=AUTOMATIC)
def automatic(world, request):
    """Gate and image, in which an automatic source drives, and its name."""
    gate, image, _, _ = world
    gate.take(request.param.partition(":")[0])
    latch_inputs(image)
    gate.interlock = Interlock(make_table(), image, must_wait=True)
    assert gate.write(request.param, HELD) == {}
    return gate, image, request.param


def test_an_automatic_source_that_goes_on_over_a_reset_moves_nothing_until_start(
    automatic,
):
    """Before, a controller drove on by itself as soon as somebody pressed Reset."""
    gate, image, source = automatic
    gate.end()
    gate.interlock.engage()
    for _ in range(3):
        assert gate.write(source, HELD) == dict.fromkeys(HELD, "not_started")
        assert latched(image, "twist.linear_m_s") == 0.0
    assert latched(image, "control.waits_for_start") == 1.0
    gate.interlock.release()
    assert latched(image, "twist.linear_m_s") == 0.0, (
        "what it said before Start counts no more"
    )
    assert gate.write(source, HELD) == {}
    assert latched(image, "twist.linear_m_s") == 0.4
    assert latched(image, "control.waits_for_start") == 0.0


def test_what_an_automatic_source_offers_before_start_does_not_act_by_a_hand_over(
    automatic,
):
    gate, image, source = automatic
    gate.end()
    gate.interlock.engage()
    gate.take("nobody")
    gate.write(source, HELD)
    gate.take(source.partition(":")[0])
    assert latched(image, "twist.linear_m_s") == 0.0


def test_zero_lights_and_enable_need_no_start(automatic):
    gate, image, source = automatic
    gate.end()
    gate.interlock.engage()
    assert gate.write(source, AT_REST) == {}
    assert gate.write(source, {"lights.command": 2, "drive.enable": False}) == {}
    assert latched(image, "drive.enable") == 0.0


def test_a_hand_needs_no_start(world):
    gate, image, _, _ = world
    gate.interlock = Interlock(make_table(), image, must_wait=True)
    gate.end()
    gate.interlock.engage()
    for source in ("page:1", "opcua:teleop"):
        gate.take(source.partition(":")[0])
        gate.write(source, AT_REST)
        assert gate.write(source, HELD) == {}
        assert latched(image, "twist.linear_m_s") == 0.4


def test_who_waits_for_start_cannot_be_called_silent(world):
    """Its lease would lapse while what it says is refused: the next safe state."""
    gate, image, _, _ = world
    gate.interlock = Interlock(make_table(), image, must_wait=True)
    gate.leases.add("peer:a", 500.0, "ramp")
    gate.take("peer")
    gate.end()
    gate.interlock.engage()
    latch_inputs(image)
    gate.write("peer:a", AT_REST)
    gate.renew("peer:a", gate.leases.now_ns())
    before = image.pushed_rows
    gate.write("peer:a", HELD)
    assert image.pushed_rows == before


def test_a_client_that_waits_for_start_is_told_once_and_a_link_that_repeats_itself_never(
    world,
):
    gate, image, events, _ = world
    gate.interlock = Interlock(make_table(), image, must_wait=True)
    gate.interlock.engage()
    for source, told in (("opcua", 1), ("peer:a", 0)):
        gate.take(source.partition(":")[0])
        before = len(events.recent)
        for _ in range(3):
            gate.write(source, {"wheel.fl.setpoint_rpm": 5.0})
        assert len(events.recent) == before + told
    assert "Start" in next(e.message for e in events.recent if "refused" in e.message)
    assert gate.rejected["opcua", "not_started"] == 3
    assert gate.rejected["peer:a", "not_started"] == 0


def test_nobody_writes_whether_sources_wait(world):
    gate, _, _, _ = world
    for source in ("page:1", "opcua", "peer:a"):
        refused = gate.write(source, {"control.waits_for_start": False})
        assert refused == {"control.waits_for_start": "not_writable"}


def test_a_restored_state_brings_its_wait_along_and_ends_none(world):
    gate, image, _, _ = world
    table = make_table()
    interlock = gate.interlock = Interlock(table, image, must_wait=True)
    interlock.engage()
    saved = image.live.copy()
    interlock.show()
    latch_inputs(image)
    waiting = image.live.copy()
    for begins in (True, False):
        for state in (waiting, saved):
            interlock.release()
            if begins:
                interlock.engage()
            image.shadow[:] = state
            interlock.adopt()
            assert interlock.waits is (begins or state is waiting)
