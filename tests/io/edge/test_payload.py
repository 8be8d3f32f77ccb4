"""What the databus says and takes, message by message."""

import json

import numpy as np
import pytest

from hilserver.config.edge import EdgeConfig
from hilserver.image import Frame
from hilserver.io.edge import payload
from tests.fakes import make_table

GROUP = {
    "name": "a",
    "signals": ["wheel.fl.*", "sim.tick", "control.mode"],
    "writable": True,
}
TABLE = make_table()
(COLLECTION,) = payload.collections_of(
    EdgeConfig.model_validate({"groups": [GROUP]}), TABLE
)
SETPOINT = str(TABLE.slot("wheel.fl.setpoint_rpm"))


def test_quality_and_types_follow_status_and_signal():
    values, status = np.zeros(TABLE.n_slots), np.zeros(TABLE.n_slots, dtype=np.int64)
    speed, tick = TABLE.slot("wheel.fl.speed_rpm"), TABLE.slot("sim.tick")
    values[speed], values[tick] = 1.5, 2**53
    status[speed], status[tick] = 0x4000_0000, 0x8000_0000
    message = json.loads(
        payload.values(COLLECTION, Frame(0, 0, 0, 0, values, status), 7, 10**18 + 5)
    )
    points = {point["id"]: point for point in message["vals"]}
    assert message["seq"] == 7
    stamp = "2001-09-09T01:46:40.000Z"
    assert points[str(speed)] == {"id": str(speed), "val": 1.5, "ts": stamp, "qc": 1}
    assert points[str(tick)] == {
        "id": str(tick),
        "val": str(2**53),
        "ts": stamp,
        "qc": 0,
    }
    assert points[SETPOINT]["qc"] == 3


def test_a_write_is_read_by_name():
    data = json.dumps(
        {"seq": 1, "vals": [{"id": SETPOINT, "val": 3, "qc": 3}]}
    ).encode()
    assert payload.written(COLLECTION, data) == {"wheel.fl.setpoint_rpm": 3}


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"[" * 60_000, "is not JSON"),
        (b'{"a":' * 10_000, "is not JSON"),
        (b"\xff", "is not JSON"),
        (b"x" * 70_000, "70000 bytes"),
        (b"[]", "no list 'vals'"),
        (b'{"vals": [{"id": "1"}]}', "without 'id' or 'val'"),
        (b'{"vals": [{"id": "sim", "val": 1}]}', "id sim is not an input"),
    ],
)
def test_what_is_no_write_is_refused_in_words(data, reason):
    with pytest.raises(ValueError, match=reason):
        payload.written(COLLECTION, data)


def test_an_output_cannot_be_written():
    speed = TABLE.slot("wheel.fl.speed_rpm")
    with pytest.raises(ValueError, match="is not an input"):
        payload.written(
            COLLECTION, json.dumps({"vals": [{"id": speed, "val": 1}]}).encode()
        )
