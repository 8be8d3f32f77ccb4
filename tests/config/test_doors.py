"""What a door without a log-in allows: as much as whoever gives no name, unless it is granted."""

import pytest

from hilserver.config.doors import Right
from hilserver.config.root import Config

HASH = "$scrypt$ln=15,r=8,p=1$c2FsdA==$aGFzaA=="
USERS = {"policies": ["Basic256Sha256"], "users": [{"name": "shift", "password": HASH}]}
BLOCK = [
    {"signal": "wheel.fl.setpoint_rpm", "at": 0},
    {"signal": "measured.nav.x_m", "at": 4},
]
OPEN = {
    "foxglove": {"enabled": True},
    "ros2": {"enabled": True},
    "edge": {"enabled": True, "groups": [{"writable": True}]},
    "s7": {"server": {"blocks": {1: BLOCK}}},
}
ALL = {
    "Foxglove": {"measured", "command"},
    "ROS 2": {"command", "parameters"},
    "S7": {"measured", "command"},
    "databus": {"measured", "command"},
    "shared memory": set(),
}
NOTHING = {title: set() for title in ALL}


def config_of(opcua, **more):
    return Config.model_validate({**OPEN, "opcua": opcua, **more})


def rights_of(opcua, **more):
    return {door.title: set(door.rights) for door in config_of(opcua, **more).doors}


@pytest.mark.parametrize(
    ("opcua", "rights"),
    [
        ({}, ALL),
        (USERS, NOTHING),
        ({"anonymous": "observer"}, NOTHING),
        (USERS | {"anonymous": "operator"}, ALL | {"ROS 2": {"command"}}),
    ],
)
def test_a_door_without_a_log_in_allows_what_a_stranger_may(opcua, rights):
    assert rights_of(opcua) == rights


def test_a_section_grants_more_by_name():
    granted = {"enabled": True, "grants": ["measured"]}
    rights = rights_of(USERS, foxglove=granted)
    assert rights["Foxglove"] == {"measured"}
    assert rights["ROS 2"] == set()
    assert rights_of({}, foxglove={"enabled": True, "grants": []})["Foxglove"] == set()


def test_shared_memory_is_written_by_programs_only_where_its_section_says_so():
    assert not Config().doors[-1].is_open
    granted = config_of({}, shared_memory={"grants": ["command"]})
    assert granted.doors[-1].rights == {Right.COMMAND}
    assert granted.doors[-1].is_open


def test_a_network_of_ros_2_does_not_change_the_robot_itself_unless_granted():
    there = {"enabled": True, "interface": "eth0", "allow_insecure_network": True}
    assert rights_of({}, ros2=there)["ROS 2"] == {"command"}
    assert rights_of({}, ros2=there | {"grants": ["parameters"]})["ROS 2"] == {
        "parameters"
    }


def test_who_may_not_command_has_no_control_at_the_start():
    assert config_of({}).first_source == "peer"
    assert config_of(USERS).first_source == "opcua"
    granted = {"enabled": True, "grants": ["command"]}
    assert config_of(USERS, ros2=granted).first_source == "ros2"


def test_a_door_that_lost_something_names_the_key():
    [door] = [door for door in config_of(USERS).doors if door.title == "Foxglove"]
    assert door.lost == (Right.MEASURED, Right.COMMAND)
    assert door.way_out == "foxglove.grants: [measured, command]"
