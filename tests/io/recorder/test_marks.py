"""Simulated time waits for recorders in other processes, and for no dead one."""

import threading

import pytest

from hilserver.image.ring import publish_frame
from hilserver.image.shared_file import path_of
from hilserver.io.recorder import marks
from hilserver.io.recorder.marks import Mark, Marks
from hilserver.io.recorder.source import FrameSource
from tests.fakes import make_image

RING, BATCH, TICKS = 1024, 100, 6_000
VIRTUAL = {"configuration": {"scheduler": {"backend": "virtual"}}}


class Plant:
    """Makes frames in batches, as virtual time does."""

    def __init__(self, run):
        self.image = make_image(ring_length=RING, run=run)
        self.marks = Marks(self.image, self.image.name, BATCH)

    def run(self):
        for tick in range(TICKS):
            if tick % BATCH == 0:
                self.marks.wait()
            publish_frame(tick, 0, self.image.values, self.image.words)


@pytest.fixture
def plant():
    plant = Plant(VIRTUAL)
    yield plant
    plant.image.close()


def mark_files(plant):
    path = path_of(plant.image.name)
    return list(path.parent.glob(f"{path.name}.reader-*"))


def test_no_frame_is_lost_however_slow_the_recorder_is(plant):
    source = FrameSource(plant.image.name)
    making = threading.Thread(target=plant.run)
    making.start()
    ticks = []
    while len(ticks) < TICKS and not source.lost:
        if (batch := source.frames()) is not None:
            ticks += batch.frames.ticks.tolist()
    source.close()
    making.join()
    assert source.lost == 0
    assert ticks == list(range(TICKS))
    assert mark_files(plant) == []


def test_real_time_waits_for_nobody():
    plant = Plant({})
    source = FrameSource(plant.image.name)
    assert source.mark is None
    plant.run()
    source.frames()
    assert source.lost > 0
    source.close()
    plant.image.close()


def test_a_recorder_that_stands_still_is_given_up_until_it_moves(
    plant, monkeypatch, capfd
):
    monkeypatch.setattr(marks, "PATIENCE_S", 0.05)
    mark = Mark(plant.image.name)
    plant.run()
    assert capfd.readouterr().out.count("a recorder is stalled") == 1
    mark.close()


def test_the_mark_of_a_killed_recorder_is_removed(plant):
    mark = Mark(plant.image.name)
    (left,) = mark_files(plant)
    content = left.read_bytes()
    mark.close()
    left.write_bytes(content)  # what is left when its process is killed: no lock
    plant.run()
    assert mark_files(plant) == []
