"""The sections ros2 and foxglove: what is refused, in one sentence with the remedy."""

import importlib.util

import pytest
from pydantic import ValidationError

from hilserver.config import section
from hilserver.config.doors import Right
from hilserver.config.edge import EdgeConfig
from hilserver.config.foxglove import FoxgloveConfig
from hilserver.config.root import Config
from hilserver.config.ros2 import Ros2Config


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"interface": "eth0"}, "allow_insecure_network: true"),
        ({"topics": {"iotbot/rmp": "x"}}, "did you mean 'iotbot/rpm'"),
        ({"array_order": ["fl", "fl", "fr", "rr"]}, "names a wheel twice"),
        ({"service_fields": {"SendLighting.colour": "int8"}}, "no service has a field"),
        ({"namespace": "a b"}, "pattern"),
        ({"domain": 233}, "232"),
        ({"flavour": "thesis_sil", "reenable": "service"}, "no service that enables"),
        (
            {"measured": "iotbot"},
            r"publishes /iotbot/rpm/return .* set ros2\.namespace: /sim, or",
        ),
        (
            {"measured": {"topics": {"/tf": "TFMessage"}}, "publish": {"tf": True}},
            r"publishes /tf as well.* set ros2\.topics: {/tf: /sim/tf} ",
        ),
        (
            {
                "namespace": "/sim",
                "topics": {"iotbot/imu": "/iotbot/imu"},
                "measured": "iotbot",
            },
            r"publishes /iotbot/imu as well.* set ros2\.topics: {iotbot/imu: /sim/iotbot/imu}",
        ),
        (
            {"measured": {"topics": {"cmd_vel": "Odometry"}}},
            r"is driven by /cmd_vel as well.* set ros2\.namespace",
        ),
        (
            {"measured": {"topics": {"odom": "Odometry", "/odom": "Odometry"}}},
            "/odom twice",
        ),
        ({"publish": ["tf", "/tf"]}, "names /tf twice"),
        ({"publish": ["imu"]}, "imu"),
        (
            {"measured": {"frame": "/map", "base_frame": "map"}},
            "frame and base_frame are the same",
        ),
    ],
)
def test_what_cannot_work_is_refused(keys, said):
    with pytest.raises(ValidationError, match=said):
        Ros2Config(enabled=True, **keys)


@pytest.mark.parametrize(
    ("model", "extra"),
    [
        (Ros2Config, r"hilserver\[ros2\]"),
        (FoxgloveConfig, r"hilserver\[foxglove\]"),
        (EdgeConfig, r"hilserver\[edge\]"),
    ],
)
def test_without_its_library_it_says_what_to_install(monkeypatch, model, extra):
    monkeypatch.setattr(section, "find_spec", lambda _: None)
    with pytest.raises(ValidationError, match=extra):
        model(enabled=True)
    model(enabled=False)
    assert importlib.util.find_spec("numpy")


def test_viewers_stay_on_this_computer_unless_allowed():
    with pytest.raises(ValidationError, match="allow_insecure_network"):
        FoxgloveConfig(enabled=True, host="0.0.0.0")
    FoxgloveConfig(enabled=True, host="0.0.0.0", allow_insecure_network=True)


@pytest.mark.parametrize(
    ("keys", "name", "full"),
    [
        ({}, "iotbot/rpm", "/iotbot/rpm"),
        ({"namespace": "/a/b"}, "iotbot/rpm", "/a/b/iotbot/rpm"),
        ({"flavour": "eduard"}, "cmd_vel", "/eduard/cmd_vel"),
        ({"flavour": "eduard", "namespace": "/"}, "cmd_vel", "/cmd_vel"),
        ({"namespace": "a"}, "/tf", "/tf"),
        (
            {"topics": {"iotbot/rpm": "/x/rpm"}, "namespace": "a"},
            "iotbot/rpm",
            "/x/rpm",
        ),
        ({"topics": {"iotbot/rpm": "rpm"}, "namespace": "a"}, "iotbot/rpm", "/a/rpm"),
    ],
)
def test_names(keys, name, full):
    assert Ros2Config(enabled=True, **keys).full_name(name) == full


@pytest.mark.parametrize(
    ("keys", "action", "command_enables"),
    [
        ({}, "device", False),
        ({"reenable": "command"}, "device", True),
        ({"flavour": "eduard"}, "device", False),
        ({"flavour": "thesis_sil"}, "hold", True),
        ({"flavour": "thesis_sil", "on_stale": "device"}, "device", True),
        ({"flavour": "diff_drive"}, "zero", True),
    ],
)
def test_silence_and_the_way_back_by_flavour(keys, action, command_enables):
    config = Ros2Config(enabled=True, **keys)
    assert (config.action, config.command_enables) == (action, command_enables)
    assert config.driver.policy == ("ramp" if action == "hold" else action)


@pytest.mark.parametrize(
    "asked",
    [
        ["/tf", "odometry/filtered"],
        ["tf", "/odometry/filtered"],
        {"/tf": True, "odometry/filtered": True},
        {"tf": True, "estimate": True},
    ],
)
def test_topics_are_asked_for_by_their_names_or_keys(asked):
    config = Ros2Config(enabled=True, publish=asked)
    assert [t.topic for t in config.published][-2:] == ["/tf", "odometry/filtered"]
    assert Ros2Config.model_validate(config.model_dump(mode="json")) == config


def test_a_topic_of_the_flavour_that_is_asked_for_is_written_once():
    config = Ros2Config(enabled=True, flavour="diff_drive", publish=["/tf", "/clock"])
    names = [topic.topic for topic in config.published]
    assert names == ["odom", "/tf", "joint_states", "imu", "/clock"]


HELD = {"enabled": True, "flavour": "thesis_sil"}
CELL = {
    "name": "cell",
    "endpoint": "opc.tcp://192.0.2.1:4840",
    "write": {"sim.tick": "ns=1;s=t"},
}


@pytest.mark.parametrize(
    ("sections", "machine"),
    [
        ({"peers": [CELL]}, "peers.cell may be one"),
        (
            {"shield": {"enabled": True, "device": "/dev/ttyS1"}},
            "shield.device '/dev/ttyS1'",
        ),
    ],
)
def test_a_held_command_moves_no_real_machine(sections, machine):
    with pytest.raises(ValidationError, match=machine):
        Config(ros2=HELD, **sections)
    Config(ros2=HELD | {"on_stale": "ramp"}, **sections)


def test_a_held_command_may_be_shown_on_this_computer():
    Config(ros2=HELD, peers=[CELL | {"endpoint": "opc.tcp://127.0.0.1:4840"}])


def test_it_has_control_at_the_start():
    assert Config(ros2={"enabled": True}).first_source == "ros2"
    assert (
        Config(ros2={"enabled": True}, control={"source": "opcua"}).first_source
        == "opcua"
    )


def test_the_real_robot_beside_the_simulated_one():
    """Set-points of the real robot may drive both; what each of them says is kept apart."""
    shared = {"iotbot/rpm": "/iotbot/rpm"}
    config = Ros2Config(
        enabled=True, namespace="/sim", topics=shared, measured="iotbot"
    )
    real = config.measured
    assert [real.full_name(name) for name in real.topics][:3] == [
        "/iotbot/rpm/return",
        "/iotbot/imu",
        "/iotbot/battery",
    ]
    assert config.full_name("iotbot/imu") == "/sim/iotbot/imu"
    assert Right.MEASURED in config.door.rights
    assert Right.MEASURED not in Ros2Config(enabled=True).door.rights
    Ros2Config(enabled=True, measured={"namespace": "/real"})
    Ros2Config(enabled=True, flavour="thesis_sil", measured="iotbot")


def test_iotbot_is_short_for_its_topics():
    short, whole = (
        Ros2Config(enabled=True, namespace="/a", measured=m) for m in ("iotbot", {})
    )
    assert short == whole
    assert Ros2Config.model_validate(short.model_dump(mode="json")) == short
