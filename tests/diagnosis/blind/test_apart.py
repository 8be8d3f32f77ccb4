"""The process that diagnoses carries no generator: `judging.PROGRAM` says so of every blind log."""

import os
import subprocess
import sys

from tests.diagnosis.blind.judging import PROGRAM, ROOT

GENERATOR = "import sys; sys.path.append('tests/injector'); import hilserver_injector\n"


def ran(program):
    words = [sys.executable, "-c", program, "cache"]
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        words, capture_output=True, text=True, check=False, cwd=ROOT, env=environment
    )


def test_a_process_that_loads_a_generator_is_found_out():
    found_out = ran(GENERATOR + PROGRAM)
    assert found_out.returncode == 1
    assert "has loaded ['hilserver_injector" in found_out.stderr
    assert ran(PROGRAM).returncode == 0
