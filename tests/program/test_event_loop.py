"""How tasks end."""

import asyncio

from hilserver.program import event_loop


def test_tasks_have_ended_whatever_they_do_when_they_are_cancelled() -> None:
    seen: list[str] = []

    async def tidies_up() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0)
            seen.append("tidy")

    async def breaks() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            seen.append("broken")
            raise ValueError

    async def main() -> None:
        tasks = [asyncio.create_task(tidies_up()), asyncio.create_task(breaks())]
        await asyncio.sleep(0)
        await event_loop.end(*tasks, None)
        assert all(task.done() for task in tasks)

    event_loop.run(main())
    assert sorted(seen) == ["broken", "tidy"]
