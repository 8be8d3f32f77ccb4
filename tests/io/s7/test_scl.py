"""The text declares every signal at the place at which it is read and written."""

import re

from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.config.root import Config
from hilserver.config.s7 import FORMS, BlockPlace, overlap
from hilserver.io.s7.scl import to_scl

MEMBER = re.compile(r"^ {6}(\w+) : (?:ARRAY\[0\.\.(\d+)\] OF )?(\w+);", re.MULTILINE)


def laid_out(text):
    """Where a controller puts the members of a block with standard access: name -> (type, at)."""
    at, found = 0, {}
    for name, last, kind in MEMBER.findall(text):
        if kind == "BOOL" and not last:
            found[name] = (kind, f"{at // 8}.{at % 8}")
            at += 1
            continue
        size = FORMS[kind].size
        unit = 16 if last or size > 1 else 8
        at = -(-at // unit) * unit
        found[name] = (kind, str(at // 8))
        at += 8 * size * (int(last or 0) + 1)
        at = -(-at // 16) * 16 if last else at
    return found


@st.composite
def places(draw):
    kind = draw(st.sampled_from(sorted(FORMS)))
    byte = draw(st.integers(0, 60))
    if kind == "BOOL":
        return kind, f"{byte}.{draw(st.integers(0, 7))}"
    return kind, str(byte - byte % 2 if FORMS[kind].size > 1 else byte)


@given(st.lists(places(), min_size=1, max_size=12))
@settings(max_examples=400, deadline=None)
def test_every_member_stands_where_the_layout_says(found):
    chosen = []
    for kind, at in found:
        if overlap([BlockPlace.parse(*one) for one in [*chosen, (kind, at)]]) is None:
            chosen.append((kind, at))
    layout = [
        {"signal": f"signal.n{number}", "type": kind, "at": at}
        for number, (kind, at) in enumerate(chosen)
    ]
    text = to_scl(Config.model_validate({"s7": {"server": {"blocks": {5: layout}}}}))
    assert 'DATA_BLOCK "hilserver_DB5"' in text
    declared = laid_out(text)
    assert {f"signal_n{n}": tuple(one) for n, one in enumerate(chosen)} == {
        name: where for name, where in declared.items() if name.startswith("signal")
    }


def test_a_peers_blocks_are_there_with_their_heartbeat():
    peer = {
        "name": "plc",
        "endpoint": "s7://192.0.2.20/0/1",
        "read": {"DB1,REAL4": "wheel.fl.setpoint_rpm"},
        "write": {"wheel.fl.speed_rpm": "DB2,REAL0"},
        "heartbeat": {"read": ["DB1,UINT0", "DB1,UINT8"]},
    }
    text = to_scl(Config.model_validate({"peers": [peer]}))
    coming, going = text.split("\n\n")
    assert 'DATA_BLOCK "plc_DB1"' in coming
    assert laid_out(coming) == {
        "heartbeat": ("UINT", "0"),
        "fill_1": ("BYTE", "2"),
        "wheel_fl_setpoint_rpm": ("REAL", "4"),
        "heartbeat_2": ("UINT", "8"),
    }
    assert 'DATA_BLOCK "plc_DB2"' in going
    assert laid_out(going) == {"wheel_fl_speed_rpm": ("REAL", "0")}
