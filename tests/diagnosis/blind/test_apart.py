"""The process that diagnoses carries no generator: `judging.PROGRAM` says so of every blind log."""

import subprocess
import sys

from tests.diagnosis.blind.judging import PROGRAM, ROOT

GENERATOR = "import sys; sys.path.append('tests/injector'); import hilserver_injector\n"


def test_a_process_that_loads_a_generator_is_found_out():
    words = [sys.executable, "-c", GENERATOR + PROGRAM, "cache"]
    found_out = subprocess.run(
        words, capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert found_out.returncode == 1
    assert "has loaded ['hilserver_injector" in found_out.stderr
