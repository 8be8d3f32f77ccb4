"""Reset alone moves nothing: a hand has to be at rest first."""

import pytest

from hilserver.core.events import EventBus
from tests.core.test_inputs import latched
from tests.fakes import ManualClock, make_gate, make_image, make_table

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
def test_a_hand_that_is_held_over_a_reset_moves_nothing_until_it_was_at_rest(world, source):
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
