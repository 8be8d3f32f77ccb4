"""Logs that hold little, or hold it in an odd way: no crash, and nothing found that is not there.

Each is a sound machine's log of the injector from which something was taken.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hilserver_injector import make

from hilserver.bench.diagnose_worker import measured
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.output import documents
from tests.diagnosis.assertions import nothing_is_found
from tests.diagnosis.hidden.logs import assembly, recipe


@cache
def sound():
    made = recipe("nothing drive", 1, 45.0)
    return measured(make(made)[0], made)


def judged(log):
    found = diagnose(log, assembly(), jobs=1)
    assert "report.html" in documents(found)
    return found.findings


def moved(log, by_s):
    """The log with other stamps."""
    channels = {name: replace(c, t_s=c.t_s + by_s) for name, c in log.channels.items()}
    spans = tuple(replace(s, start_s=s.start_s + by_s, end_s=s.end_s + by_s) for s in log.spans)
    return replace(log, channels=channels, spans=spans)


def held_at(log, words, value):
    """The log with some channels constant."""
    held = {
        name: c.with_values(np.full(len(c), value))
        for name, c in log.channels.items()
        if any(word in name for word in words)
    }
    return log.with_channels(held)


def only(log, *words):
    """The log without the channels that have none of these words in their names."""
    return log.without([n for n in log.channels if not any(word in n for word in words)])


@pytest.mark.parametrize(
    ("words", "plant"),
    [
        (["fl.s", "rl.s", "nav.", "gyro"], {}),
        (["setpoint", "nav."], {"track_m": 0.31, "wheelbase_m": 0.25}),
    ],
    ids=["speeds of one side", "set-points of a machine with an unknown drive"],
)
def test_wheels_that_nobody_knows_of_do_not_stand_still(words, plant):
    findings = judged(replace(only(sound(), *words), plant=plant))
    nothing_is_found(findings)
    (reason,) = [n.reason for n in findings.not_judged if n.cause == "rotation_gain"]
    assert "no wheel speed of both sides" in reason


def test_seconds_since_1970_are_no_error_of_the_drive():
    nothing_is_found(judged(moved(sound(), 1.7e9)))


def test_a_machine_that_was_asked_for_nothing_has_a_report():
    judged(held_at(sound(), ["setpoint"], 0.0))


@pytest.mark.parametrize("value", [0.0, 1e-9])
def test_channels_without_noise_overflow_nothing(value):
    judged(held_at(sound(), ["."], value))
