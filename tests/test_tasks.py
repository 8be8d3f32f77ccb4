"""Tasks that outlive their call: none ends without a word, and those that last begin again."""

import ast
import asyncio
from pathlib import Path

import pytest

import hilserver
from hilserver import tasks
from hilserver.tasks import Ended, Supervisor, first_of, together
from hilserver.time_limit import AbandonedError


class Told(list[Ended]):
    """A supervisor's words, with short pauses."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__()
        monkeypatch.setattr(tasks, "FIRST_PAUSE_S", 0.001)
        monkeypatch.setattr(tasks, "LONGEST_PAUSE_S", 0.004)
        self.tasks = Supervisor(self.append)


@pytest.fixture
def told(monkeypatch):
    return Told(monkeypatch)


async def forever():
    await asyncio.Event().wait()


async def until(condition):
    async with asyncio.timeout(5):
        while not condition():  # noqa: ASYNC110 - what is waited for is not an event
            await asyncio.sleep(0.001)


async def returns():
    await asyncio.sleep(0)


async def fails():
    await asyncio.sleep(0)
    raise ValueError("no bread")


async def leaks():
    await asyncio.sleep(0)
    raise asyncio.CancelledError


@pytest.mark.parametrize(
    ("work", "why"),
    [
        (returns, "returned"),
        (fails, "failed: ValueError: no bread"),
        (leaks, "was cancelled from outside"),
    ],
)
async def test_a_task_that_lasts_begins_again_whatever_ends_it(told, work, why):
    async with told.tasks as kept:
        kept.keep("baker", work)
        await until(lambda: kept.restarts["baker"] >= 5)
    assert {ended.why for ended in told} == {why}
    pauses = [ended.again_in_s for ended in told[:5]]
    assert pauses == [0.001, 0.002, 0.004, 0.004, 0.004], (
        "the pauses grow up to a limit"
    )
    assert str(told[0]) == f"task 'baker' {why}; it begins again in 0.001 s"


async def test_a_foreign_cancellation_also_in_the_pause_does_not_end_it(told):
    async with told.tasks as kept:
        job = kept.keep("baker", forever)
        await asyncio.sleep(0)
        for _ in range(3):
            before = job.task
            before.cancel()
            await asyncio.wait({before})
            before.cancel()
            assert kept.why_down() == "task 'baker' was cancelled from outside"
            assert kept.up() == {"baker": False}
            await until(lambda: job.task is not before)  # noqa: B023 - it ends within the turn
            assert kept.why_down() == ""
            assert kept.up() == {"baker": True}
    assert kept.restarts == {"baker": 3}


async def test_what_we_end_ends_without_a_word(told):
    kept = told.tasks
    job = kept.keep("baker", forever)
    waits = kept.keep("fails", fails)
    await until(lambda: kept.restarts["fails"])
    del told[:]
    await waits.end()
    await job.end()
    assert (job.done, waits.done, kept.jobs, told) == (True, True, {}, [])


@pytest.mark.parametrize(("work", "n_told"), [(returns, 0), (fails, 1), (leaks, 1)])
async def test_a_task_that_ends_by_itself_may_only_return(told, work, n_told):
    ends = []
    job = told.tasks.spawn(work, "one loaf")
    job.on_end = lambda: ends.append(job.done)
    await until(lambda: job.done)
    assert ends == [True]
    assert told.tasks.failures == {"one loaf": n_told}, (
        "the series exists from the start"
    )
    assert [ended.again_in_s for ended in told] == [None] * n_told
    assert (told.tasks.jobs, told.tasks.why_down()) == ({}, "")


async def test_a_loop_that_hangs_is_named_and_begins_again(told, monkeypatch):
    monkeypatch.setattr(tasks, "SILENT_AT_LEAST_S", 0.02)
    turns = []

    async def look():
        turns.append(1)
        if len(turns) == 2:
            await forever()

    async with told.tasks as kept:
        kept.every("oven", 0.001, look)

        def looked():
            kept.look()
            return len(turns) > 4

        await until(looked)
    assert told[0].why.startswith("has not turned for")
    assert told[1].again_in_s is not None
    assert kept.restarts == {"oven": 1}


async def test_if_the_whole_loop_stood_still_no_task_is_to_blame(told, monkeypatch):
    async with told.tasks as kept:
        kept.every("oven", 60, lambda: None)
        kept.look()
        await asyncio.sleep(0)
        loop = asyncio.get_running_loop()
        later_s = loop.time() + 1e4
        monkeypatch.setattr(loop, "time", lambda: later_s)
        kept.look()
        monkeypatch.undo()
    assert told == []


async def test_of_several_the_first_to_end_counts():
    assert await first_of(forever(), returns()) == 1
    assert await first_of(forever(), within_s=0) is None
    with pytest.raises(ValueError, match="no bread"):
        await first_of(forever(), fails())


@pytest.mark.parametrize(
    ("work", "error"),
    [
        (returns, "returns returned"),
        (leaks, "leaks was cancelled"),
        (fails, "no bread"),
    ],
)
async def test_of_those_that_belong_together_none_ends_alone(work, error):
    with pytest.raises((AbandonedError, ValueError), match=error):
        await together(forever(), work())


MAKERS = ("create_task", "ensure_future", "TaskGroup", "timeout", "wait_for")
HOMES = ("tasks.py", "time_limit.py", "opcua/spawning.py")


def test_nothing_else_makes_tasks_or_limits():
    """`asyncio.timeout` and `wait_for` mistake a library's cancellation for ours."""
    folder = Path(hilserver.__file__).parent
    found = []
    for path in sorted(folder.rglob("*.py")):
        place, text = (
            path.relative_to(folder).as_posix(),
            path.read_text(encoding="utf-8"),
        )
        if place in HOMES or not any(maker in text for maker in MAKERS):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Call) and isinstance(
                node.func, ast.Attribute | ast.Name
            ):
                called = ast.unparse(node.func)
                name = called.rpartition(".")[2]
                if name in MAKERS[:3] or called in (
                    "asyncio.timeout",
                    "asyncio.wait_for",
                ):
                    found.append(f"{place}:{node.lineno} {called}")
            if isinstance(node, ast.ImportFrom) and node.module == "asyncio":
                found += [
                    f"{place}:{node.lineno} {a.name}"
                    for a in node.names
                    if a.name in MAKERS
                ]
    assert found == []
