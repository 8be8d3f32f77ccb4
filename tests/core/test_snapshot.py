"""Snapshot files of others: whatever they hold, a sentence."""

import io
import json
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.core.snapshot import MOST_BYTES, SCHEMA, read_snapshot
from hilserver.errors import ControlRefused


def member(words):
    out = io.BytesIO()
    np.lib.format.write_array(out, words)
    return out.getvalue()


def npz(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(f"{name}.npy", data)
    return path


META = member(np.array(json.dumps({"schema": SCHEMA, "tick": 0, "identity": {}})))
STATE = member(np.zeros(8, dtype=np.int64))


def test_a_sound_one_is_read(tmp_path):
    state, meta = read_snapshot(npz(tmp_path / "a.npz", state=STATE, meta=META))
    assert state.tolist() == [0] * 8
    assert meta["tick"] == 0


def test_what_unpacks_to_much_is_refused_before_it_is_unpacked(tmp_path):
    path = npz(tmp_path / "a.npz", state=bytes(MOST_BYTES + 1), meta=META)
    assert path.stat().st_size < 100_000
    with pytest.raises(
        ControlRefused, match="unpacks to more than 64 MB, more than any"
    ):
        read_snapshot(path)


def test_a_shape_that_is_a_lie_is_damage(tmp_path):
    data = member(np.zeros(8, dtype=np.int64)).replace(
        b"(8,), }", b"(9999999999999,), }"[:19]
    )
    for state in (data, b"", b"\x93NUMPY\x01\x00\xff\xff{", STATE[:-9]):
        with pytest.raises(ControlRefused, match=r"damaged|does not follow"):
            read_snapshot(npz(tmp_path / "a.npz", state=state, meta=META))


@given(st.data())
@settings(max_examples=40, deadline=None)
def test_any_bytes_are_read_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.npz"
    npz(path, state=STATE, meta=META)
    whole = bytearray(path.read_bytes())
    for place in data.draw(st.lists(st.integers(0, len(whole) - 1), max_size=10)):
        whole[place] = data.draw(st.integers(0, 255))
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole)))])
    try:
        read_snapshot(path)
    except ControlRefused as error:
        said = str(error)
    else:
        said = ""
    assert "\n" not in said
