"""Readings of a duty that pile up below the drive's limit: the log's limit, or the drive's."""

from dataclasses import replace

import pytest
from hilserver_injector import make, nothing, single
from hilserver_injector.recipe import Sensor

from benchmarks.diagnose_worker import measured
from hilserver.diagnosis.checks import check
from hilserver.diagnosis.decide import limited_duty
from tests.diagnosis.assertions import said
from tests.diagnosis.hidden.logs import assembly, judged


def limited(made, limit, seconds=60.0):
    sensors = {**made.sensors, "duty_pct": Sensor(limit=limit)}
    return replace(made, duration_s=seconds, sensors=sensors)


def found(made):
    log = check(measured(make(made)[0]), assembly().robot).log
    return limited_duty.find(log, assembly().robot)


@pytest.mark.parametrize("kind", ["drive", "bench"])
@pytest.mark.parametrize("limit", [95.0, 70.0])
def test_a_log_that_ends_below_the_drive_is_a_limited_channel(kind, limit):
    log, (finding,) = found(limited(nothing(kind, 5), limit))
    assert finding.causes == ("limited_channel",)
    assert finding.parameters["limited_channel"].value == limit
    assert set(log.limits.values()) == {limit}
    assert set(log.limits) == set(finding.regressors)


@pytest.mark.parametrize("limit", [95.0, 70.0])
def test_a_drive_that_is_limited_is_no_limited_channel(limit):
    """A driver that reports what it puts out ends at the drive's own limit, too."""
    made = replace(single("saturation_limit", 5), causes={"saturation_limit": limit})
    assert found(limited(made, limit))[1] == []


def test_a_log_without_a_limit_is_none():
    assert found(limited(nothing("bench", 5), 100.0))[1] == []


def test_beside_the_limit_of_the_log_nothing_is_found():
    findings = judged(limited(nothing("bench", 6), 95.0)).findings
    assert said(findings) == ["data_fault: limited_channel"]
