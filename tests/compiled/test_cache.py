"""Compiled kernels are kept by the text of all that they call."""

from pathlib import Path

import pytest

from hilserver.compiled import cache, cache_dir
from hilserver.image.ring import copy_latest
from hilserver.io.shield.framing import feed
from hilserver.io.shield.protocol import crc8


@pytest.fixture
def room(tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "_PACKAGE", tmp_path)
    room = tmp_path / "io" / "line"
    room.mkdir(parents=True)
    return room


def test_a_room_with_another_constant_has_other_kernels(room):
    """The constant stands in one file, the kernel that has it built in stands in another."""
    (room / "words.py").write_text("BYTES = 22\n")
    before = cache.room_dir.__wrapped__(room)
    (room / "words.py").write_text("BYTES = 23\n")
    assert cache.room_dir.__wrapped__(room) != before


def test_the_rooms_of_the_plant_share_one_place():
    assert Path(copy_latest._cache.cache_path).parent == cache_dir()


def test_another_room_has_its_place_within():
    places = {Path(kernel._cache.cache_path).parent for kernel in (feed, crc8)}
    assert {place.parent for place in places} == {cache_dir()}
    assert len(places) == 1
