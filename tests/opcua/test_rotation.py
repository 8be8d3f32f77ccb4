"""Turns: fair, bounded, and the event loop's other work comes in between."""

import asyncio

import pytest

from hilserver.opcua import rotation as module
from hilserver.opcua.rotation import BUDGET_S, Rotation


class Clock:
    """Time that passes only while jobs work."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s


class Work:
    """A job of some turns, each of which takes a while."""

    def __init__(
        self, clock: Clock, done: list[str], name: str, turns: int, took_s: float
    ) -> None:
        self.clock, self.done, self.name, self.left, self.took_s = (
            clock,
            done,
            name,
            turns,
            took_s,
        )

    def turn(self) -> bool:
        self.clock.now_s += self.took_s
        self.done.append(self.name)
        self.left -= 1
        return self.left > 0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


async def until_done(rotation: Rotation) -> None:
    async with asyncio.timeout(120):
        while len(rotation):  # noqa: ASYNC110
            await asyncio.sleep(0)


async def test_everybody_has_a_turn_before_anybody_has_two(clock: Clock) -> None:
    rotation, done = Rotation(), []
    for name in "abc":
        rotation.add(Work(clock, done, name, 3, BUDGET_S))
    await until_done(rotation)
    assert done == list("abc" * 3)


async def test_a_flood_leaves_the_loop_to_others_after_each_budget(
    clock: Clock,
) -> None:
    """What drives the robot has its callback between any two portions of the flood."""
    rotation, done = Rotation(), []
    for number in range(100):
        rotation.add(Work(clock, done, f"flood {number}", 2, BUDGET_S / 2))

    async def control() -> None:
        while len(rotation):
            done.append("control")
            await asyncio.sleep(0)

    await control()
    portions = "".join("c" if name == "control" else "f" for name in done).split("c")
    assert max(map(len, portions)) == 2
    assert done.count("control") > 90


async def test_a_job_waits_once_and_can_be_dropped(clock: Clock) -> None:
    rotation, done = Rotation(), []
    once, never = Work(clock, done, "once", 1, 0.0), Work(clock, done, "never", 1, 0.0)
    for job in (once, never, once):
        rotation.add(job)
    rotation.drop(never)
    await until_done(rotation)
    assert done == ["once"]


async def test_a_failing_job_harms_nobody_else(clock: Clock) -> None:
    rotation, done = Rotation(), []

    class Fails:
        def turn(self) -> bool:
            raise ValueError("filter")

    rotation.add(Fails())
    rotation.add(Work(clock, done, "next", 1, 0.0))
    await until_done(rotation)
    assert done == ["next"]
