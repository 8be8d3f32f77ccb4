"""What every program gets: errors as sentences, exit codes, a clean end by signals."""

import os
import signal
import subprocess

import pytest

from hilserver.errors import ConfigError, FailedError, LogError
from hilserver.program import event_loop, harness
from hilserver.program.children import python
from hilserver.program.ending import hang_ups_wait, on_end


@pytest.mark.parametrize(
    ("error", "code", "sentence"),
    [
        (FailedError("port 4840 is in use"), 1, "hilserver: port 4840 is in use\n"),
        (LogError("a.csv:3: no number"), 2, "hilserver: a.csv:3: no number\n"),
        (ConfigError("first\nsecond"), 78, "hilserver: first\nhilserver: second\n"),
        (
            PermissionError(13, "Permission denied", "/x"),
            1,
            "hilserver: /x: permission denied\n",
        ),
        (TimeoutError(), 1, "hilserver: no answer in time\n"),
        (
            MemoryError(),
            1,
            "hilserver: there is not enough memory for this; use smaller files\n",
        ),
    ],
)
def test_an_error_is_a_sentence_and_an_exit_code(
    error, code, sentence, capsys, monkeypatch
):
    monkeypatch.setattr("hilserver.program.harness._drop_output", lambda: None)

    def main():
        raise error

    assert harness.run(main) == code
    assert capsys.readouterr().err == sentence


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_program_cleanly_wherever_it_is(number):
    def main():
        os.kill(os.getpid(), number)
        raise AssertionError("nothing comes after it")

    before = signal.getsignal(number)
    assert harness.run(main) == 0
    assert signal.getsignal(number) is before


def test_a_program_that_can_be_stopped_in_order_goes_on_to_its_end():
    stops = []

    def main():
        on_end(lambda: stops.append(1))
        os.kill(os.getpid(), signal.SIGTERM)
        return 3

    assert harness.run(main) == 3
    assert stops == [1]


def test_an_error_of_ours_is_not_hidden():
    def main():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        harness.run(main)


EVENT_LOOP = """
import asyncio, os, signal, sys
from hilserver.program import event_loop, harness

async def serve():
    asked = event_loop.end_event()
    with event_loop.hang_ups() as hung_up:
        os.kill(os.getpid(), signal.SIGHUP)
        await hung_up.wait()
    os.kill(os.getpid(), signal.SIGTERM)
    await asked.wait()
    return 3

sys.exit(harness.run(lambda: event_loop.run(serve())))
"""


def test_an_event_loop_hears_the_signals():
    assert (
        subprocess.run(python("-c", EVENT_LOOP), timeout=600, check=False).returncode
        == 3
    )


@pytest.fixture
def default_hang_up():
    """As a program begins; who runs the tests may have them ignore it (nohup)."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("default_hang_up")
async def test_a_hang_up_that_comes_too_early_or_too_late_waits_and_ends_nothing():
    with hang_ups_wait():
        os.kill(os.getpid(), signal.SIGHUP)
        with event_loop.hang_ups() as hung_up:
            assert hung_up.is_set()
        with event_loop.hang_ups() as hung_up:
            assert not hung_up.is_set()
        os.kill(os.getpid(), signal.SIGHUP)
        with event_loop.hang_ups() as hung_up:
            assert hung_up.is_set()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL
