"""What enables the drive again after a silence, and what does not."""

import pytest

from hilserver.io.ros2.way_back import WayBack

GO = {"control.mode": 0, "wheels.setpoints_rpm": [10.0, 10.0, -10.0, -10.0]}
REST = {"control.mode": 0, "wheels.setpoints_rpm": [0.0, 0.0, 0.0, 0.0]}
TURN = {"control.mode": 1, "twist.linear_m_s": 0.0, "twist.angular_rad_s": 0.1}
LIGHTS = {"lights.command": 4}


def answers(commands, *, command_enables=True):
    way = WayBack(command_enables=command_enables)
    way.withdraw()
    return [way.enables(command) for command in commands]


@pytest.mark.parametrize(
    ("commands", "enabling"),
    [
        ([GO, GO, GO], None),
        ([REST, GO, GO], 1),
        ([GO, REST, TURN], 2),
        ([REST, LIGHTS, REST], 2),
        ([LIGHTS, GO], None),
    ],
)
def test_a_command_enables_once_the_host_was_at_rest(commands, enabling):
    assert answers(commands) == [place == enabling for place in range(len(commands))]


def test_where_the_service_enables_no_command_does():
    assert not any(answers([REST, GO, REST, GO], command_enables=False))


def test_nothing_is_given_back_that_was_not_withdrawn():
    way = WayBack(command_enables=True)
    assert not any(way.enables(command) for command in (REST, GO))
    way.withdraw()
    way.enables(REST)
    way.forget()
    assert not way.enables(GO), "a Stop, or enable by the service, came in between"
