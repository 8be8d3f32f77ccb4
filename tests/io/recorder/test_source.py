"""What the recorder reads from the image: every frame once, losses counted, segments told apart."""

import numpy as np
import pytest

from hilserver.errors import FailedError
from hilserver.image.layout import REQUEST_LOAD, REQUEST_SAVE
from hilserver.image.requests import post_request, serve
from hilserver.image.ring import publish_frame
from hilserver.image.shared_file import path_of
from hilserver.image.state_request import ask_for_state, take_request
from hilserver.io.recorder.source import FrameSource
from tests.fakes import make_image

RING = 1024


class World:
    """An image whose ticks the test makes, and a recorder's view of it."""

    def __init__(self):
        self.image = make_image(ring_length=RING, live={"x": 4})
        self.source = FrameSource(self.image.name)
        self.tick = 0

    def run(self, n):
        for _ in range(n):
            self.tick = serve(self.image.control.request, self.tick, self.image.words)
            publish_frame(self.tick, 0, self.image.values, self.image.words)
            self.tick += 1

    def read(self):
        """Return (segment, tick) of every frame that is there."""
        found = []
        while (batch := self.source.frames()) is not None:
            ticks = batch.frames.ticks.tolist()
            found += zip(batch.segments.tolist(), ticks, strict=True)
        return found

    def request(self, kind, tick):
        post_request(kind, tick, self.image.words)


@pytest.fixture
def world():
    world = World()
    yield world
    world.source.close()
    if path_of(world.image.name).exists():
        world.image.close()


def test_every_frame_is_read_once(world):
    world.run(700)
    assert world.read() == [(0, tick) for tick in range(700)]
    assert world.read() == []
    world.run(900)
    assert world.read() == [(0, tick) for tick in range(700, 1600)]
    assert world.source.lost == 0


def test_what_the_ring_dropped_is_counted_and_begins_no_segment(world):
    world.run(10)
    world.read()
    world.run(3 * RING)
    frames = world.read()
    assert world.source.lost + len(frames) == 3 * RING
    assert {segment for segment, _ in frames} == {0}
    assert frames[-1] == (0, 10 + 3 * RING - 1)


def test_what_came_while_the_file_was_made_is_not_lost(world):
    """Opening a file takes seconds on a busy computer; the recording has not begun by then."""
    world.run(3 * RING)
    world.source.begin()
    world.run(10)
    assert [tick for _, tick in world.read()] == list(range(3 * RING, 3 * RING + 10))
    assert world.source.lost == 0


def test_a_restore_begins_a_segment_with_its_state(world):
    world.run(10)
    world.read()
    region = world.image.layout.regions["shadow"]
    world.image.words[region.base : region.base + region.length] = 77
    world.request(REQUEST_LOAD, 4)
    world.run(3)
    state = world.source.state()
    assert (state.segment, state.tick) == (1, 4)
    assert set(state.words.tolist()) == {77}
    assert world.read() == [(1, 4), (1, 5), (1, 6)]
    assert world.source.state() is None


def test_a_state_that_is_noticed_after_its_frames_finds_its_segment(world):
    world.run(10)
    world.request(REQUEST_LOAD, 0)
    world.run(5)
    world.read()
    state = world.source.state()
    assert (state.segment, state.tick) == (1, 0)


def test_a_restore_to_a_later_tick_begins_a_segment_too(world):
    world.run(10)
    world.request(REQUEST_LOAD, 500)
    world.run(2)
    assert world.read()[-2:] == [(1, 500), (1, 501)]


def test_a_saved_state_belongs_to_the_present_segment(world):
    world.run(10)
    world.read()
    world.image.values[world.image.layout.regions["x"].base] = 2.5
    world.request(REQUEST_SAVE, 0)
    world.run(1)
    state = world.source.state()
    assert (state.segment, state.tick) == (0, 10)
    assert 2.5 in state.words.view(np.float64)


def test_the_state_before_the_first_tick_needs_no_request(world):
    assert (world.source.first_state().segment, world.source.first_state().tick) == (
        0,
        0,
    )
    world.run(1)
    assert world.source.first_state() is None


def test_a_request_for_a_state_is_taken_once(world):
    assert not take_request(world.image.name)
    world.source.ask_for_state()
    ask_for_state(world.image.name)
    assert take_request(world.image.name)
    assert not take_request(world.image.name)


def test_the_end_of_the_daemon_is_noticed(world):
    assert not world.source.daemon_is_gone()
    world.image.close()
    assert world.source.daemon_is_gone()


def test_without_a_daemon_it_says_so():
    with pytest.raises(
        FailedError, match="no process image 'nobody'; is the daemon running"
    ):
        FrameSource("nobody")
