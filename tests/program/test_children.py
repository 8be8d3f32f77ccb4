"""Children end with the context that started them, by force if they have to."""

import asyncio
import re
import subprocess

import pytest

from hilserver.program import event_loop
from hilserver.program.children import line_of, piped, python, started, write

OBEDIENT = "import time; print('ready', flush=True); time.sleep(600)"
STUBBORN = f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {OBEDIENT}"
READY = re.compile(rb"^ready")


@pytest.mark.parametrize(("program", "signal"), [(OBEDIENT, -15), (STUBBORN, -9)])
async def test_a_child_of_an_event_loop_ends_with_its_context(program, signal):
    async with started(
        python("-c", program), name="child", stop_limit_s=0.5, stdout=subprocess.PIPE
    ) as process:
        assert await line_of(process, READY, 60.0)
    assert process.returncode == signal


async def test_a_child_that_ends_early_has_no_line():
    async with started(
        python("-c", "print('no')"),
        name="child",
        stop_limit_s=5.0,
        stdout=subprocess.PIPE,
    ) as process:
        assert await line_of(process, READY, 60.0) is None


async def test_a_child_that_says_nothing_is_not_waited_for_without_limit():
    async with started(
        python("-c", "import time; time.sleep(600)"),
        name="child",
        stop_limit_s=5.0,
        stdout=subprocess.PIPE,
    ) as process:
        assert await line_of(process, READY, 0.05) is None


@pytest.mark.parametrize(("program", "signal"), [(OBEDIENT, -15), (STUBBORN, -9)])
def test_a_child_with_pipes_ends_with_its_context(program, signal, capfd):
    with piped(python("-c", program), name="the child", stop_limit_s=0.5) as process:
        assert process.stdout.readline() == "ready\n"
    assert process.returncode == signal
    assert ("the child did not stop and was killed" in capfd.readouterr().err) == (
        signal == -9
    )


def test_the_error_of_the_parent_ends_the_child_too():
    with (
        pytest.raises(ZeroDivisionError),
        piped(python("-c", OBEDIENT), name="child") as process,
    ):
        1 / 0  # noqa: B018
    assert process.returncode == -15


def test_nothing_comes_of_writing_to_a_child_that_has_ended():
    async def late():
        process = await asyncio.create_subprocess_exec(
            *python("-c", ""), stdin=asyncio.subprocess.PIPE
        )
        await process.wait()
        for _ in range(3):
            await write(process, bytes(1 << 20))
        return process.returncode

    assert event_loop.run(late()) == 0
