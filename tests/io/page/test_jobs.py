"""A diagnosis runs at idle priority; whoever waits for it sees why nothing moves."""

import asyncio

from hilserver.io.page.jobs import ShareOfTime


async def test_a_diagnosis_that_gets_no_time_says_so():
    """Before, nothing moved for minutes, and nobody said why."""
    idle = await asyncio.create_subprocess_exec("sleep", "60")
    busy = await asyncio.create_subprocess_exec("sh", "-c", "while :; do :; done")
    try:
        shares = {process: ShareOfTime() for process in (idle, busy)}
        waits = {idle: False, busy: False}
        for _ in range(12):
            await asyncio.sleep(0.25)
            waits = {p: share.is_small(p.pid, over_s=2.0) for p, share in shares.items()}
        assert waits == {idle: True, busy: False}
    finally:
        for process in (idle, busy):
            process.kill()
            await process.wait()
