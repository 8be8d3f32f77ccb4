"""The configuration that a recording carries: none, or a damaged one, is a sentence."""

from pathlib import Path

import numpy as np
import pytest

from hilserver.errors import LogError
from hilserver.logs import Log
from hilserver.replay import assembly_of


@pytest.mark.parametrize(
    ("run", "says"),
    [
        ({}, "contains no configuration"),
        ({"configuration": None}, "contains no configuration"),
        ({"configuration": "plant: !!float ''\n"}, "does not match this version"),
        (
            {"configuration": "plant: {max_rpm: !!bool maybe}\n"},
            "does not match this version",
        ),
        ({"configuration": "- 1\n"}, "does not match this version"),
        ({"configuration": "[" * 3000}, "does not match this version"),
    ],
)
def test_a_configuration_that_cannot_be_read_is_a_sentence(run, says):
    log = Log(Path("run.mcap"), np.zeros(1), np.zeros(1, dtype=np.int64), {}, run=run)
    with pytest.raises(LogError, match=f"run.mcap: .*{says}"):
        assembly_of(log)
