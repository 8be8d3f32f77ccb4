"""What a process does not need it does not carry."""

import subprocess
import sys

import pytest

LOADED = "import sys, hilserver.commands.{}; print(*{} & sys.modules.keys())"
COMPILER = {"numba", "scipy"}


@pytest.mark.parametrize(
    ("command", "without"),
    [
        ("page", COMPILER | {"pydantic", "structlog", "yaml"}),
        *((command, COMPILER) for command in ("call", "set", "inject", "teleop")),
    ],
)
def test_commands_that_only_watch_or_ask_carry_little(command, without):
    words = [sys.executable, "-c", LOADED.format(command, without)]
    assert subprocess.run(words, capture_output=True, text=True, check=True).stdout == "\n"
