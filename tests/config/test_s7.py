"""Data blocks in a configuration: what is no place, no block or no controller is named."""

import pytest
from pydantic import ValidationError

from hilserver.config.root import Config
from hilserver.config.s7 import Address, BlockPlace, Endpoint

PEER = {
    "name": "plc",
    "endpoint": "s7://192.0.2.20/0/1",
    "read": {"DB1,REAL4": "wheel.fl.setpoint_rpm"},
}


def complaint(**sections):
    with pytest.raises(ValidationError) as caught:
        Config.model_validate(sections)
    return str(caught.value)


def layout(*fields, **server):
    return {"server": {"blocks": {1: list(fields)}, **server}}


def field(at, kind="REAL", signal="a"):
    return {"signal": signal, "at": at, "type": kind}


def test_addresses_are_those_of_node_red():
    assert Address.parse("DB1,REAL4") == (1, BlockPlace("REAL", 4))
    assert Address.parse("db20,x6.1") == (20, BlockPlace("BOOL", 6, 1))
    assert Address.parse("DB3,DI8") == Address.parse("DB3,DINT8")
    assert Endpoint.parse("s7://plc:1102/0/2") == ("plc", 1102, 0, 2)
    assert Endpoint.parse("s7://[::1]/0/1") == ("::1", 102, 0, 1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("DB1,REAL", "write DB1,REAL4"),
        ("DB1,TEXT4", "types are X, BYTE"),
        ("DB1,REAL3", "a REAL must start at an even byte"),
        ("DB1,X3", "a BOOL has a bit"),
        ("DB1,INT2.1", "a INT has no bit"),
        ("DB1,REAL9000", "at most 8192 bytes"),
    ],
)
def test_what_is_no_place_is_named(text, words):
    assert words in complaint(peers=[PEER | {"read": {text: "wheel.fl.setpoint_rpm"}}])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"endpoint": "s7://192.0.2.20"}, "write s7://<host>/<rack>/<slot>"),
        ({"endpoint": "s7://192.0.2.20:0/0/1"}, "write s7://<host>/<rack>/<slot>"),
        ({"endpoint": "opc.tcp://192.0.2.20:4840"}, "has no 'DB1,REAL4': write nsu="),
        (
            {"write": {"wheel.fl.speed_rpm": "ns=1;s=x"}},
            "has no 'ns=1;s=x': write DB1,REAL4",
        ),
        ({"mode": "subscribe"}, "mode of peer 'plc' is for opc.tcp://"),
        (
            {"sequence_node": "DB1,UINT0"},
            "sequence_node of peer 'plc' is for opc.tcp://",
        ),
        (
            {"security": {"policy": "Basic256Sha256"}},
            "security of peer 'plc' is for opc.tcp://",
        ),
        ({"read": {"DB1,REAL4": "a", "DB2,REAL4": "b"}}, "DB1 and DB2 are two blocks"),
        ({"read": {"DB1,REAL4": "a", "DB1,INT6": "b"}}, "byte 6 is named twice"),
        (
            {"read": {"DB1,REAL0": "a", "DB1,REAL300": "b"}},
            "304 bytes come in several parts",
        ),
        ({"heartbeat": {"read": ["DB1,UINT0", "DB1,UDINT8"]}}, "of the same type"),
        (
            {"heartbeat": {"read": ["DB1,REAL0", "DB1,REAL8"]}},
            "integers of the same type",
        ),
        ({"heartbeat": {"read": ["DB1,UINT8", "DB1,UINT10"]}}, "the first and last"),
        ({"poll_ms": 500}, "must be at least twice the interval"),
    ],
)
def test_what_is_no_controller_or_no_block_is_named(changes, words):
    assert words in complaint(peers=[PEER | changes])


def test_a_heartbeat_belongs_to_an_s7_controller():
    peer = {
        "name": "iot",
        "endpoint": "opc.tcp://192.0.2.20:4840",
        "read": {"ns=1;s=x": "a"},
        "heartbeat": {"read": ["DB1,UINT0", "DB1,UINT8"]},
    }
    assert "use sequence_node" in complaint(peers=[peer])


@pytest.mark.parametrize(
    ("section", "words"),
    [
        (layout(field(0), field(2, "INT", "b")), "'a' and 'b' overlap"),
        (layout(field(1)), "must start at an even byte"),
        (layout(field("x")), "at 'x': write the byte"),
        (layout(field(0, "STRING")), "type"),
        (layout(field(0), host="192.0.2.1"), "S7 has no passwords"),
    ],
)
def test_what_is_no_layout_is_named(section, words):
    assert words in complaint(s7=section)


def test_bits_share_a_byte():
    bits = [field(f"4.{bit}", "BOOL", f"b{bit}") for bit in range(8)]
    config = Config.model_validate({"s7": layout(field(0), *bits)})
    assert config.s7.server.blocks[1][8].place == BlockPlace("BOOL", 4, 7)
    assert not config.s7.drives
