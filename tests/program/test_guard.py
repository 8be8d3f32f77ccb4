"""Signals end a program whose main thread does not get to them."""

import signal
import subprocess
import time

import pytest

from hilserver.program.children import python

HEAD = """
import subprocess, sys, threading, time
from pathlib import Path
from hilserver.program.guard import guarded, on_forced_end
with guarded() as guard:
    guard.say = lambda text: print(text, flush=True)
    on_forced_end(Path(sys.argv[1]).unlink)
"""
STARTING = """
    subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])
    print('ready', flush=True)
    while True: pass
"""
BLOCKED = """
    guard.on_end(lambda: print('asked', flush=True), lambda: print('at rest', flush=True))
    print('ready', flush=True)
    while True: pass
"""
SLOW = """
    guard.on_end(guard.answer, lambda: print('at rest', flush=True))
    print('ready', flush=True)
    time.sleep(600)
"""
ORDERLY = """
    asked = threading.Event()
    guard.on_end(lambda: (guard.answer(), asked.set()), lambda: None)
    print('ready', flush=True)
    asked.wait()
sys.exit(3)
"""


def ended(tmp_path, program, *pauses_s):
    """Send a signal, and one more after each pause; return code, seconds and what was said."""
    file = tmp_path / "image"
    file.touch()
    command = python("-c", HEAD + program, str(file))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        start_s = time.monotonic()
        process.send_signal(signal.SIGTERM)
        for pause_s in pauses_s:
            time.sleep(pause_s)
            process.send_signal(signal.SIGINT)
        said, _ = process.communicate(
            timeout=60
        )  # its children hold the pipe: they have ended, too
        return (
            process.returncode,
            time.monotonic() - start_s,
            said.splitlines(),
            file.exists(),
        )


def test_what_is_starting_ends_at_once_with_its_children(tmp_path):
    code, took_s, said, is_left = ended(tmp_path, STARTING)
    assert (code, said, is_left) == (
        0,
        ["has stopped while it was starting, exit code 0"],
        False,
    )
    assert took_s < 2.0


@pytest.mark.parametrize("program", [BLOCKED, SLOW])
def test_what_does_not_end_is_ended_within_three_seconds(tmp_path, program):
    code, took_s, said, is_left = ended(tmp_path, program)
    blocked = [
        "asked",
        "at rest",
        "is forced to exit: its event loop is blocked, exit code 1",
    ]
    slow = ["is forced to exit: a part did not stop in time, exit code 0"]
    assert (said, code) == ((blocked, 1) if program is BLOCKED else (slow, 0))
    assert not is_left
    assert took_s < 3.0


def test_a_second_signal_ends_at_once(tmp_path):
    code, took_s, said, is_left = ended(tmp_path, BLOCKED, 0.3)
    assert said == ["asked", "exits at once: a second signal arrived, exit code 0"]
    assert (code, is_left) == (0, False)
    assert took_s < 1.4


def test_what_ends_in_order_keeps_its_exit_code(tmp_path):
    code, _, said, is_left = ended(tmp_path, ORDERLY)
    assert (code, said, is_left) == (3, [], True)
