"""Sensors as ordinary machines have them are no effect, and hide none: rounded, limited, held."""

from dataclasses import replace

import pytest
from hilserver_injector.cases import cases
from hilserver_injector.ordinary import ordinary

from tests.diagnosis.assertions import said, the_cause_is_named
from tests.diagnosis.hidden.logs import judged, recipe

SHORTER_S = {
    "sensors/drive/1401": 90.0,
    "sensors/bench/701": 15.0,
    "sensors/stand/700": 30.0,
}
NULL = {case.key: case for case in cases("sensors", range(700, 706))}
ON_A_STAND = {
    case.key: case for case in cases("sensors", (9003, 9004)) if case.name == "stand"
}  # four wheels alike, whose rounding asks for a turn; held speeds, known to a row
BESIDE = [
    ("rotation_gain", 1, 120.0),
    ("wheel_radius", 1, 240.0),
    ("imu_latency", 1, 180.0),
    ("saturation_limit", 1, 60.0),
    ("coulomb_friction", 2, 20.0),
    ("time_constant", 1, 20.0),
    ("process_gain", 1, 20.0),
]
IN_ANY_RUN = {("coulomb_friction", 2, 20.0)}


def some(logs, quick):
    return [
        pytest.param(log, marks=[] if log in quick else [pytest.mark.long])
        for log in logs
    ]


def only_faults_are_found(case, recipe):
    """What a sensor's limit or clock keeps from the log is said; nothing else is."""
    faults = {f"data_fault: {name}" for names in case.answer.causes for name in names}
    assert {*said(judged(recipe).findings)} <= faults


@pytest.mark.parametrize("key", some(NULL, ()))
def test_ordinary_sensors_are_no_effect(key):
    only_faults_are_found(NULL[key], NULL[key].recipe)


@pytest.mark.parametrize("key", ON_A_STAND)
def test_wheels_in_the_air_tell_nothing_but_their_drive(key):
    only_faults_are_found(ON_A_STAND[key], ON_A_STAND[key].recipe)


@pytest.mark.parametrize("key", SHORTER_S)
def test_ordinary_sensors_are_no_effect_in_a_short_log(key):
    only_faults_are_found(
        NULL[key], replace(NULL[key].recipe, duration_s=SHORTER_S[key])
    )


@pytest.mark.parametrize("log", some(BESIDE, IN_ANY_RUN), ids=str)
def test_ordinary_sensors_hide_no_cause(log):
    findings = judged(ordinary(recipe(*log))).findings
    faults = tuple(f for f in findings.findings if f.causes != ("limited_channel",))
    the_cause_is_named(findings.model_copy(update={"findings": faults}), log[0])
