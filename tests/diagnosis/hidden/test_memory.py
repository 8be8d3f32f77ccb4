"""Ten minutes at 50 Hz, all causes: the memory of the whole process."""

import subprocess
import sys

import pytest

PROGRAM = """
import resource
from tests.diagnosis.hidden.logs import judged, recipe
assert judged(recipe("rotation_gain", 3, 600.0), jobs=2).findings.findings
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.long
def test_ten_minutes_take_less_than_a_gigabyte():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    assert int(done.stdout.split()[-1]) * 1024 < 1e9
