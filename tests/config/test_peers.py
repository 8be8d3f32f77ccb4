"""The `peers:` section: what is accepted, and one sentence for what is not."""

import pytest
import yaml
from pydantic import ValidationError

from hilserver.config.peers import NodeAddress, PeerConfig, check_peers, check_signals
from hilserver.signals import Ranges, robot_table

SPEC_EXAMPLE = """
name: iot2050
endpoint: opc.tcp://192.0.2.10:53880/UA/NodeRedAgv
security: {policy: None}
mode: auto                 # subscribe | poll | auto
publishing_ms: 50
sampling_ms: 0
poll_ms: 10
stale_after_ms: 500
on_stale: ramp
read:
  "nsu=urn:iotbot:agv;s=rpm_set_FL": wheel.fl.setpoint_rpm
sequence_node: "nsu=urn:iotbot:agv;s=seq"
write:
  wheel.fl.speed_rpm: "nsu=urn:iotbot:agv;s=rpm_act_FL"
write_every_ms: 20
"""

SECURE = {"policy": "Basic256Sha256"}
LOG_IN = {"user": "otto", "password_file": "password"}
TABLE = robot_table(Ranges(90.0, 1.0, 1.0))


def example(**changes: object) -> dict[str, object]:
    return yaml.safe_load(SPEC_EXAMPLE) | changes


def test_the_example_of_the_specification():
    peer = PeerConfig.model_validate(example())
    assert peer.security.policy == "None"
    assert peer.read == {"nsu=urn:iotbot:agv;s=rpm_set_FL": "wheel.fl.setpoint_rpm"}
    assert check_signals(peer, TABLE) == []


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("nsu=urn:iotbot:agv;s=seq", NodeAddress("urn:iotbot:agv", None, "s=seq")),
        ("ns=1;s=AGV.rpm;set=FL", NodeAddress(None, 1, "s=AGV.rpm;set=FL")),
        ("ns=0;i=2258", NodeAddress(None, 0, "i=2258")),
        ("nsu=http://a%3Bb/;s=x", NodeAddress("http://a;b/", None, "s=x")),
    ],
)
def test_node_ids(text, address):
    assert NodeAddress.parse(text) == address


@pytest.mark.parametrize(
    "text", ["", "rpm", "s=rpm", "ns=x;s=rpm", "nsu=;s=rpm", "ns=1;i=rpm"]
)
def test_what_is_no_node_id(text):
    with pytest.raises(ValueError, match="is not a node id"):
        NodeAddress.parse(text)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mode": "push"}, "'auto', 'subscribe' or 'poll'"),
        ({"publishin_ms": 5}, "Extra inputs are not permitted"),
        ({"endpoint": "192.0.2.10:53880"}, "is not an endpoint"),
        (
            {"endpoint": "opc.tcp://me:secret@192.0.2.10:53880/"},
            "must not contain a user name",
        ),
        ({"endpoint": "opc.tcp://192.0.2.10:port/"}, "is not an endpoint"),
        (
            {"endpoint": "opc.tcp://192.0.2.10:0/"},
            "needs the port that the peer listens on",
        ),
        ({"sampling_ms": float("nan")}, "finite number"),
        ({"stale_after_ms": 60}, "at least twice the interval"),
        ({"poll_ms": 0}, "greater than or equal to 1"),
        ({"publishing_ms": -1}, "greater than 0"),
        ({"read": {}, "write": {}}, "reads and writes nothing"),
        (
            {"security": {"policy": "Basic256"}},
            "Input should be 'None', 'Basic256Sha256'",
        ),
        ({"security": {"mode": "sign"}}, "mode has no effect while policy is None"),
        (
            {"security": {"peer_host": "x"}},
            "peer_host has no effect while policy is None",
        ),
        ({"security": {"trust": "x"}}, "trust has no effect while policy is None"),
        (
            {"security": SECURE | {"certificate": "a.der"}},
            "certificate needs private_key as well: give both, or neither",
        ),
        (
            {"security": SECURE | {"private_key": "a.pem"}},
            "private_key needs certificate as well",
        ),
        ({"security": SECURE | {"user": "otto"}}, "user needs password_file as well"),
        (
            {"security": SECURE | {"password_file": "x"}},
            "password_file needs user as well",
        ),
        ({"security": SECURE | {"password": "x"}}, "Extra inputs are not permitted"),
        ({"security": LOG_IN}, "could read the password of 'otto' with policy None"),
        (
            {"security": SECURE | LOG_IN | {"allow_clear_password": True}},
            "allow_clear_password has no effect",
        ),
        (
            {"security": {"allow_clear_password": True}},
            "allow_clear_password has no effect",
        ),
        ({"sequence_node": "seq"}, "is not a node id"),
        ({"name": "a b"}, "String should match pattern"),
        (
            {"read": {"ns=1;s=a": "control.mode", "ns=1;s=b": "control.mode"}},
            "names 'control.mode' twice",
        ),
    ],
)
def test_mistakes_are_one_sentence(changes, message):
    with pytest.raises(ValidationError, match=message):
        PeerConfig.model_validate(example(**changes))


def test_a_secure_peer_encrypts_unless_told_otherwise():
    security = PeerConfig.model_validate(example(security=SECURE)).security
    assert security.is_secure
    assert security.effective_mode == "sign_and_encrypt"
    signs = PeerConfig.model_validate(
        example(security=SECURE | {"mode": "sign"})
    ).security
    assert signs.effective_mode == "sign"
    assert not PeerConfig.model_validate(example()).security.is_secure


@pytest.mark.parametrize(
    "changes",
    [
        {"security": LOG_IN | {"allow_clear_password": True}},
        {"security": LOG_IN, "endpoint": "opc.tcp://127.0.0.1:4840/"},
        {"security": LOG_IN, "endpoint": "opc.tcp://[::1]:4840/"},
        {"security": LOG_IN, "endpoint": "opc.tcp://localhost:4840/"},
    ],
)
def test_a_password_in_the_clear_only_where_nobody_listens_or_on_request(changes):
    assert PeerConfig.model_validate(example(**changes)).security.user == "otto"


def test_signals_are_checked_against_the_table():
    peer = PeerConfig.model_validate(
        example(
            read={
                "ns=1;s=a": "wheel.fl.setpoint_rmp",
                "ns=1;s=b": "wheel.fl.speed_rpm",
                "ns=1;s=d": "wheel.rr.set_rpm",
            },
            write={"wheel.fl.setpoint_rpm": "ns=1;s=c"},
        )
    )
    problems = {
        problem.location: problem.message for problem in check_signals(peer, TABLE)
    }
    assert problems == {
        ("read", "ns=1;s=a"): "there is no signal 'wheel.fl.setpoint_rmp'; did you mean"
        " 'wheel.fl.setpoint_rpm'?",
        (
            "read",
            "ns=1;s=b",
        ): "'wheel.fl.speed_rpm' is an output, so no peer can set it",
        ("read", "ns=1;s=d"): "there is no signal 'wheel.rr.set_rpm'; did you mean"
        " 'wheel.rr.setpoint_rpm'?",
        (
            "write",
            "wheel.fl.setpoint_rpm",
        ): "'wheel.fl.setpoint_rpm' is an input: write sends outputs",
    }


def test_two_peers_may_not_share_a_name_or_an_input():
    first = PeerConfig.model_validate(example())
    second = PeerConfig.model_validate(example(name="other"))
    assert [p.message for p in check_peers([first, second])] == [
        "'wheel.fl.setpoint_rpm' is set by two peers, 'iot2050' and 'other'"
    ]
    assert check_peers([first, first])[0].message == "two peers have the name 'iot2050'"
