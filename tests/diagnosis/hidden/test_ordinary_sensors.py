"""Sensors as ordinary machines have them are no effect: rounded, limited, on a stand."""

from dataclasses import replace

import pytest
from hilserver_injector.cases import cases

from tests.diagnosis.assertions import said
from tests.diagnosis.hidden.logs import judged

SHORTER_S = {"sensors/drive/1401": 90.0, "sensors/bench/701": 15.0, "sensors/stand/700": 30.0}
NULL = {case.key: case.recipe for case in cases("sensors", range(700, 706))}


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("key", NULL)
def test_ordinary_sensors_are_no_effect(key):
    """What a sensor's limit keeps from the log is said; nothing else is."""
    findings = judged(NULL[key]).findings
    assert {*said(findings)} <= {"data_fault: limited_channel"}


@pytest.mark.parametrize("key", SHORTER_S)
def test_ordinary_sensors_are_no_effect_in_a_short_log(key):
    findings = judged(replace(NULL[key], duration_s=SHORTER_S[key])).findings
    assert {*said(findings)} <= {"data_fault: limited_channel"}
