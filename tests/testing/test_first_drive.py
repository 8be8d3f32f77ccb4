"""The programs of the tutorial's first drive, against the demonstration that it starts."""

import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.daemons import running_daemon

EXAMPLES = Path(__file__).parents[2] / "examples"
FOLDER = Path(__file__).parents[2] / "docs" / "tutorial" / "first-drive"


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    with running_daemon(tmp_path_factory.mktemp("demo"), "--demo") as daemon:
        yield daemon


def lines(program, daemon):
    command = [sys.executable, FOLDER / program, daemon.url]
    ended = subprocess.run(
        command, capture_output=True, text=True, timeout=600, check=False
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.splitlines()


def test_watch_shows_a_robot_that_moves(demo):
    poses = lines("watch.py", demo)
    assert len(poses) == 10
    assert len(set(poses)) > 1


def test_drive_takes_control_moves_and_gives_it_back(demo):
    first, *speeds, last = lines("drive.py", demo)
    assert (first, last) == ("control: opcua", "control: peer")
    driven = [float(re.search(r"-?\d+\.\d+", line).group()) for line in speeds]
    assert driven[-1] == pytest.approx(20 / 60 * 2 * 3.141593 * 0.085, rel=0.05)


@pytest.mark.parametrize(
    "program",
    [
        FOLDER / "watch.py",
        FOLDER / "drive.py",
        EXAMPLES / "own-controller/drive_square.py",
    ],
)
def test_before_the_daemon_listens_it_says_so(program):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        nobody = f"opc.tcp://127.0.0.1:{taken.getsockname()[1]}/hilserver"
    command = [sys.executable, program, nobody]
    ended = subprocess.run(
        command, capture_output=True, text=True, timeout=600, check=False
    )
    assert ended.returncode == 1
    assert re.fullmatch(
        f"{nobody} does not answer: wait until .* its addresses\n", ended.stderr
    )
