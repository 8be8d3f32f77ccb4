"""Why causes are not judged."""

import random

import hypothesis
import hypothesis.strategies as st
import pytest

from hilserver.diagnosis.catalogue.vocabulary import CAUSES
from hilserver.diagnosis.regression.stages import foretold
from hilserver.diagnosis.replay.judgeable import (
    NO_STAGE,
    UNSEEN,
    WITHOUT_CANDIDATE,
    vocabulary_reasons,
)
from tests.diagnosis.checks.samples import ROBOT, drive, log_of


@pytest.mark.parametrize(
    ("lacks", "line"),
    [
        (
            (),
            "This log shows the drive and the motion by position, heading, turn rate.",
        ),
        (
            ("setpoint",),
            "This log shows the motion by position, heading, turn rate; not judged: the drive (no"
            " set-points in the log).",
        ),
        (
            ("nav.yaw", "imu."),
            "This log shows the drive and the motion by position; not judged: its heading (no"
            " navigation yaw in the log), its turn rate (no turn rate in the log).",
        ),
        (
            ("wheel.",),
            "This log shows nothing to judge; not judged: the drive (no set-points in the log, no"
            " wheel speed in the log), the motion (no wheel speed on both sides).",
        ),
    ],
)
def test_a_line_says_beforehand_what_a_log_can_show(lacks, line):
    t, columns = drive(length_s=20.0)
    kept = {
        name: v
        for name, v in columns.items()
        if not any(part in name for part in lacks)
    }
    assert foretold(log_of(t, kept), ROBOT) == line


@hypothesis.given(st.integers(0, 10**6), st.sets(st.sampled_from(sorted(CAUSES))))
def test_reasons_stand_in_one_order_however_they_were_gathered(seed, judged):
    """Sets are gathered in another order by every process: findings.json would differ."""
    names = [*CAUSES, "of another library"]
    random.Random(seed).shuffle(names)
    reasons = dict.fromkeys(names[: len(names) // 2], "no channel")
    found = vocabulary_reasons(judged, reasons, {"drive", "pose"})
    places = [
        list(CAUSES).index(name) if name in CAUSES else len(CAUSES) for name in found
    ]
    assert places == sorted(places)
    assert not found.keys() & judged
    assert reasons.keys() - judged <= found.keys()


@hypothesis.given(
    st.sets(st.sampled_from(sorted(CAUSES))),
    st.sets(st.sampled_from(["drive", "pose"])),
)
def test_every_cause_is_either_judged_or_not(judged, stages):
    found = vocabulary_reasons(judged, {}, stages, NO_STAGE, UNSEEN)
    physical = {name for name, cause in CAUSES.items() if cause.physical}
    assert physical - WITHOUT_CANDIDATE <= judged | found.keys()
    assert not judged & found.keys()
