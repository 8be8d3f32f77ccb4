"""The input queues: groups are latched whole, timed rows at their tick."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.image import Row
from hilserver.image.queues import latch_rows
from tests.fakes import make_image


@pytest.fixture(scope="module")
def image():
    image = make_image(queue_rows=8)
    yield image
    image.close()


def latch(image, tick):
    latch_rows(tick, image.values, image.words)
    return image.frame_values.copy()


def test_timed_rows_wait_for_their_tick(image):
    assert image.push_timed([Row(0, 1.0, tick=5), Row(0, 2.0, tick=7)])
    assert latch(image, 4)[0] == 0.0
    assert latch(image, 5)[0] == 1.0
    assert latch(image, 9)[0] == 2.0


def test_status_travels_with_the_value(image):
    image.push([Row(3, 1.0, status=0x40900000)])
    latch(image, 0)
    assert image.frame_status[3] == 0x40900000


def test_a_row_without_a_number_sets_the_status_alone(image):
    image.push([Row(3, 7.0)])
    image.push([Row(3, math.nan, status=0x40900000)])
    assert latch(image, 0)[3] == 7.0
    assert image.frame_status[3] == 0x40900000


@given(st.lists(st.lists(st.floats(-80, 80), min_size=1, max_size=5), max_size=20))
def test_queue_is_first_in_first_out_and_never_splits_a_group(groups):
    image = make_image(queue_rows=8)
    try:
        held: list[float] = []
        for tick, group in enumerate(groups):
            fits = len(held) + len(group) <= 8
            assert image.push([Row(0, value) for value in group]) == fits
            held += group if fits else []
            if tick % 2:
                expected = held[-1] if held else image.frame_values[0]
                assert latch(image, tick)[0] == expected
                held = []
    finally:
        image.close()
