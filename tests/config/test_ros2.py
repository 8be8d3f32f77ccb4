"""The sections ros2 and foxglove: what is refused, in one sentence with the remedy."""

import importlib.util

import pytest
from pydantic import ValidationError

from hilserver.config import section
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
        ({"topics": {"iotbot/rpm": "/x/rpm"}, "namespace": "a"}, "iotbot/rpm", "/x/rpm"),
        ({"topics": {"iotbot/rpm": "rpm"}, "namespace": "a"}, "iotbot/rpm", "/a/rpm"),
    ],
)
def test_names(keys, name, full):
    assert Ros2Config(enabled=True, **keys).full_name(name) == full


def test_it_has_control_at_the_start():
    assert Config(ros2={"enabled": True}).first_source == "ros2"
    assert Config(ros2={"enabled": True}, control={"source": "opcua"}).first_source == "opcua"
