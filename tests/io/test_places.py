"""Who asks for something gets in, however many places are held without asking for anything."""

import pytest

from hilserver.io.places import YIELDS_AFTER_S, PlaceKeeper, PlaceUse

HERE, THERE, ELSEWHERE = "127.0.0.1", "192.0.2.1", "192.0.2.2"


class Hall:
    def __init__(self, most=4):
        self.now_s, self.ended = 0.0, []
        self.places = PlaceKeeper(most, lambda: self.now_s)

    def enter(self, name, address=HERE, use=PlaceUse.OPENS):
        self.now_s += 0.01
        place = self.places.take(address, lambda: self.ended.append(name))
        if place is not None and use is not PlaceUse.OPENS:
            self.places.progress(place, use)
        return place


@pytest.fixture
def hall():
    return Hall()


def test_half_open_ones_yield_at_once_the_oldest_first(hall):
    hall.enter("asks", use=PlaceUse.WATCHES)
    for name in ("a", "b", "c", "d", "e"):
        assert hall.enter(name)
    assert hall.ended == ["a", "b"]
    assert len(hall.places) == 4


def test_who_makes_progress_stays_and_who_does_not_yields(hall):
    held = [hall.enter(name, use=PlaceUse.WATCHES) for name in "abcd"]
    assert hall.enter("late") is None
    hall.now_s += YIELDS_AFTER_S
    hall.places.progress(held[0])
    assert hall.enter("late")
    assert hall.ended == ["b"]


def test_who_drives_yields_as_the_last(hall):
    held = [hall.enter("driver", use=PlaceUse.DRIVES)]
    held += [hall.enter(name, use=PlaceUse.WATCHES) for name in "abc"]
    hall.now_s += 2 * YIELDS_AFTER_S
    for name in "xyz":
        assert hall.enter(name, use=PlaceUse.WATCHES)
    assert hall.ended == ["a", "b", "c"]
    hall.places.progress(held[0])
    assert held[0].use is PlaceUse.DRIVES
    assert hall.enter("late") is None


def test_one_address_gets_half_of_the_places(hall):
    for name in "ab":
        hall.enter(name, THERE, PlaceUse.WATCHES)
    assert hall.enter("c", THERE) is None
    assert hall.enter("d", ELSEWHERE)
    assert hall.ended == []


def test_the_address_with_the_most_places_loses_one(hall):
    hall.enter("one", ELSEWHERE)
    for name in "abcd":
        hall.enter(name)
    assert hall.ended == ["a"]


def test_who_has_left_or_yielded_frees_its_place_once(hall):
    held = [hall.enter(name) for name in "abcd"]
    for place in (held[0], held[0], held[1]):
        hall.places.leave(place)
    assert len(hall.places) == 2
