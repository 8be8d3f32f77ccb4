"""`make run` ends with exit code 0 on Ctrl-C: a real make, a terminal, a program that ends well."""

import os
import pty
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

FOREGROUND = Path(__file__).parents[2] / ".ci" / "foreground.py"

# Counts its interrupts for a moment and tells them with its exit code.
PROGRAM = """
import signal, time
count = 0
def interrupted(*_):
    global count
    count += 1
signal.signal(signal.SIGINT, interrupted)
print("ready", flush=True)
while not count:
    time.sleep(0.01)
time.sleep(0.2)
raise SystemExit(count - 1)
"""


@pytest.fixture
def makefile(tmp_path: Path) -> Path:
    (tmp_path / "program.py").write_text(PROGRAM)
    (tmp_path / "Makefile").write_text(
        f"run:\n\t@{sys.executable} {FOREGROUND} {sys.executable} program.py\n\t@echo gone on\n"
    )
    return tmp_path


def read_until(descriptor: int, text: bytes, timeout_s: float = 20.0) -> bytes:
    """Read from a pty until `text` came; an empty `text` reads to its end."""
    got = b""
    while not text or text not in got:
        readable, _, _ = select.select([descriptor], [], [], timeout_s)
        assert readable, f"{text!r} did not come, only {got!r}"
        try:
            chunk = os.read(descriptor, 1024)
        except OSError:  # how Linux tells that the other side of a pty is closed
            return got
        if not chunk:
            return got
        got += chunk
    return got


def test_ctrl_c_in_a_terminal_leaves_make_alive_and_reaches_the_program_once(
    makefile: Path,
) -> None:
    master, slave = pty.openpty()
    make = subprocess.Popen(
        ["setsid", "--ctty", "make", "-C", str(makefile), "run"],
        stdin=slave,
        stdout=slave,
        stderr=slave,
    )
    os.close(slave)
    read_until(master, b"ready")
    os.write(master, b"\x03")
    rest = read_until(master, b"")
    assert make.wait(600) == 0, rest
    assert b"gone on" in rest
    os.close(master)


def test_a_signal_to_the_whole_group_reaches_the_program_once(makefile: Path) -> None:
    with subprocess.Popen(
        [sys.executable, str(FOREGROUND), sys.executable, "program.py"],
        cwd=makefile,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        start_new_session=True,
    ) as wrapper:
        assert wrapper.stdout is not None
        assert wrapper.stdout.readline() == b"ready\n"
        os.killpg(wrapper.pid, signal.SIGINT)
        assert wrapper.wait(600) == 0


@pytest.mark.parametrize(
    ("program", "code"),
    [("raise SystemExit(78)", 78), ("import os; os.kill(os.getpid(), 9)", 137)],
)
def test_the_exit_code_is_the_program_s(program: str, code: int) -> None:
    command = [sys.executable, str(FOREGROUND), sys.executable, "-c", program]
    assert (
        subprocess.run(command, stdin=subprocess.DEVNULL, check=False).returncode
        == code
    )
