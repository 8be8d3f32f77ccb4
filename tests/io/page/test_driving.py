"""Browsers that want the wheel at the same time: what one has sent is done before another one's."""

import asyncio
import itertools
from types import SimpleNamespace

import pytest

from hilserver.io.page.driving import PageDriving
from hilserver.io.page.hand import RefusedError

PAGE, NOBODY = {"control.source": "page"}, {"control.source": "nobody"}
STEPS = 6


class Hand:
    """Writes as slowly as a daemon that answers some turns of the event loop later."""

    def __init__(self, name, written):
        self.rights = SimpleNamespace(drive=True)
        self._name, self._written = name, written

    async def write(self, values):
        for _ in range(STEPS):
            await asyncio.sleep(0)
        self._written.append((self._name, dict(values)))


class Seat:
    def __init__(self, number, name, written):
        self.number, self.browser = number, SimpleNamespace(hand=Hand(name, written))
        self.messages = []

    def tell(self, message):
        self.messages.append(message)


@pytest.fixture
async def rig():
    driving, written = PageDriving(deadman_ms=300.0), []
    loop = asyncio.create_task(driving.run())
    yield driving, Seat(1, "first", written), Seat(2, "second", written), written
    loop.cancel()


async def turns(n):
    for _ in range(n):
        await asyncio.sleep(0)


@pytest.mark.parametrize("late", range(3 * STEPS))
async def test_who_leaves_takes_no_control_away_from_who_comes(rig, late):
    driving, first, second, written = rig
    await driving.take(first)
    driving.leave(first)
    await turns(late)
    await driving.take(second)
    await turns(9 * STEPS)
    assert driving.driver is second
    *before, last = [entry for entry in written if "control.source" in entry[1]]
    assert last == ("second", PAGE), before


@pytest.mark.parametrize("late", range(3 * STEPS))
async def test_no_command_of_before_comes_after_control_was_taken(rig, late):
    driving, first, second, written = rig
    await driving.take(first)
    driving.command(first, {"mode": "twist", "linear": 0, "turn": 0})
    await turns(late)
    await driving.take(second)
    await turns(9 * STEPS)
    names = [name for name, _ in written]
    assert [name for name, _ in itertools.groupby(names)] == ["first", "second"]
    assert first.messages == [
        {"type": "refused", "text": "another browser has taken control"},
    ]


async def test_who_leaves_stands_first_and_gives_control_back(rig):
    driving, first, _, written = rig
    await driving.take(first)
    driving.leave(first)
    await turns(9 * STEPS)
    assert driving.driver is None
    (_, rest), (_, given) = written[1:]
    assert rest["twist.linear_m_s"] == rest["twist.angular_rad_s"] == 0.0
    assert given == NOBODY


@pytest.mark.parametrize("late", range(2 * STEPS))
async def test_of_two_that_ask_at_once_the_second_is_asked_whether_it_means_it(
    rig, late
):
    driving, first, second, _ = rig

    def check():
        if driving.driver is not None:
            raise RefusedError("another browser drives")

    asked = asyncio.create_task(driving.take(first, check))
    await turns(late + 1)
    with pytest.raises(RefusedError, match="another browser drives"):
        await driving.take(second, check)
    await asked
    assert driving.driver is first
    assert driving.is_new
