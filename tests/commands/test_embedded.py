"""What is said when the embedded controller does not start: the truth."""

import re
import sys

import pytest

from hilserver.commands import demo
from hilserver.errors import FailedError


async def start(script):
    async with demo._serving([sys.executable, "-c", script], "controller"):
        pass


async def test_one_that_ends_is_named_with_its_exit_code_and_command():
    words = f"controller ended with exit code 3 before it listened; .* run {sys.executable} -c"
    with pytest.raises(FailedError, match=words):
        await start("import sys; sys.exit(3)")


async def test_one_that_hangs_is_said_to_run(monkeypatch):
    monkeypatch.setattr(demo, "START_LIMIT_S", 0.2)
    monkeypatch.setattr(demo, "ENDS_WITHIN_S", 0.1)
    with pytest.raises(
        FailedError, match=re.escape("runs, but does not listen after 0.2 s")
    ):
        await start("import time; time.sleep(600)")
