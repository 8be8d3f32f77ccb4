"""Compiled kernels are kept by the text of all that they call."""

import os
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


def test_a_cache_of_another_user_is_not_unpickled(tmp_path, monkeypatch):
    monkeypatch.setenv("HILSERVER_CACHE_DIR", str(tmp_path))
    folder = cache.cache_dir.__wrapped__()
    if os.getuid() == 0:  # what root made is everybody's
        os.chown(folder, 4711, -1)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(PermissionError, match="belongs to another user"):
        cache.cache_dir.__wrapped__()


def test_nobody_else_may_write_to_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("HILSERVER_CACHE_DIR", str(tmp_path))
    folder = cache.cache_dir.__wrapped__()
    folder.chmod(0o777)
    assert cache.cache_dir.__wrapped__().stat().st_mode & 0o777 == 0o755


def test_every_byte_of_a_source_counts(tmp_path):
    """Only Python itself knows which text computes: a guess would run old kernels."""
    source = tmp_path / "step.py"
    source.write_text("LIMIT = 3\n")
    before = cache.hash_of([source])
    source.write_text("LIMIT = 3  # V\n")
    assert cache.hash_of([source]) != before
