"""Every fault of the paced loop has a name and a sentence."""

import pytest

from hilserver.scheduler import faults


@pytest.mark.parametrize(
    ("code", "name", "words"),
    [
        (faults.SINGLE_OVERRUN, "single_overrun_limit", "a single overrun"),
        (
            faults.CONSECUTIVE_OVERRUNS,
            "consecutive_overrun_limit",
            "more consecutive overruns",
        ),
        (faults.COMMUNICATION, "communication", "the communication side"),
        (faults.SLICE + 3, "fault 3", "a slice reported fault 3"),
    ],
)
def test_a_code_has_a_name_and_a_sentence(code, name, words):
    found = faults.fault_of(code)
    assert found.name == name
    assert found.text.startswith(words)
