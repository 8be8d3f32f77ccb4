"""What a process does not need it does not carry."""

import subprocess
import sys

import pytest

LOADED = "import sys, hilserver.commands.{}; print({{'numba', 'scipy'}} & sys.modules.keys())"


@pytest.mark.parametrize("command", ["page", "call", "set", "inject", "teleop"])
def test_commands_that_only_watch_or_ask_need_no_compiler(command):
    words = [sys.executable, "-c", LOADED.format(command)]
    assert subprocess.run(words, capture_output=True, text=True, check=True).stdout == "set()\n"
