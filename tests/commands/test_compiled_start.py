"""Which children compile for `hilserver run`."""

import argparse

import pytest

from hilserver.cache import Shelf
from hilserver.commands import compiled_start
from hilserver.compiled.supplied import Supplied

ARGS = argparse.Namespace(config="robot.yaml", patch=None, group=None)


@pytest.fixture
def places(tmp_path, monkeypatch):
    """The user's cache, and what an installation brought along, both empty."""
    monkeypatch.setenv("HILSERVER_CACHE_DIR", str(tmp_path))
    kept, brought = Shelf("kernels-test"), Supplied("test", tmp_path / "objects")
    brought.folder.mkdir(parents=True)
    monkeypatch.setattr(compiled_start, "shelf", lambda: kept)
    monkeypatch.setattr(compiled_start, "supplied", lambda: brought)
    monkeypatch.setattr(compiled_start.compiling, "processes", lambda: 3)
    return kept.folder, brought.folder


def test_an_empty_cache_is_filled_by_all_cores(places):
    (places[0] / "turn.turn-0.nbc").touch()  # another command needs a part of it
    commands = compiled_start.commands(ARGS)
    assert [command[-1] for command in commands] == [
        "--config=robot.yaml",
        "--helper",
        "--helper",
    ]


@pytest.mark.parametrize("place", [0, 1])
def test_another_step_is_compiled_by_one_child(places, place):
    (places[place] / "step_0123456789abcdef.step-0.nbc").touch()
    [command] = compiled_start.commands(ARGS)
    assert command[-2:] == ["--config=robot.yaml", "--alone"]
