"""Logs that hold little, or hold it in an odd way: no crash, and nothing found that is not there.

Each is a sound machine's log of the injector from which something was taken.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hilserver_injector import make

from benchmarks.diagnose_worker import measured
from hilserver.diagnosis.decide.lost_steps import lost_steps
from hilserver.diagnosis.engine import compare, diagnose
from hilserver.diagnosis.output import documents
from hilserver.diagnosis.progress import Tracker
from hilserver.diagnosis.regression.stages import prepare_all
from hilserver.diagnosis.report.summary import summary
from hilserver.diagnosis.schema.findings import Overall, Verdict
from hilserver.diagnosis.thresholds import FEWEST_EVENTS
from hilserver.measured.channels import SETPOINTS, SPEEDS
from hilserver.measured.data import Channel
from tests.diagnosis.assertions import nothing_is_found, said
from tests.diagnosis.hidden.logs import assembly, recipe


@cache
def sound():
    made = recipe("nothing drive", 1, 45.0)
    return measured(make(made)[0])


@cache
def long():
    made = recipe("nothing drive", 1, 240.0)
    return measured(make(made)[0])


def judged(log):
    found = diagnose(log, assembly(), jobs=1)
    assert "report.html" in documents(found)
    return found.findings


def moved(log, by_s):
    """The log with other stamps."""
    channels = {name: replace(c, t_s=c.t_s + by_s) for name, c in log.channels.items()}
    spans = tuple(
        replace(s, start_s=s.start_s + by_s, end_s=s.end_s + by_s) for s in log.spans
    )
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
    return log.without(
        [n for n in log.channels if not any(word in n for word in words)]
    )


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
    assert findings.findings == (), said(findings)
    assert findings.verdict == Overall.NOT_JUDGED
    (reason,) = [n.reason for n in findings.not_judged if n.cause == "rotation_gain"]
    assert "no wheel speed on both sides" in reason


def test_seconds_since_1970_are_no_error_of_the_drive():
    nothing_is_found(judged(moved(sound(), 1.7e9)))


def pooled(*logs):
    """Several logs of one machine as one, as the reader does."""
    channels = {}
    for name in dict.fromkeys(name for log in logs for name in log.channels):
        parts = [
            replace(log[name], span=log[name].span + k)
            for k, log in enumerate(logs)
            if name in log
        ]
        columns = [
            [getattr(part, f) for part in parts] for f in ("t_s", "values", "span")
        ]
        channels[name] = Channel(*map(np.concatenate, columns))
    spans = tuple(replace(log.spans[0], number=k) for k, log in enumerate(logs))
    return replace(logs[0], channels=channels, spans=spans)


@pytest.mark.parametrize(
    "later_s", [0.0, 3e7], ids=["both from zero", "a later year first"]
)
def test_the_stamps_of_two_logs_are_not_mixed(later_s):
    first = moved(sound(), later_s)
    both = diagnose(pooled(first, sound()), assembly(), jobs=1)
    nothing_is_found(both.findings)
    assert "report.html" in documents(both)
    moments = {row.gain.horizon_s for row in both.evidence.gain_by_horizon}
    assert any(h > 0.0 for h in moments)
    assert all(h >= 0.0 for h in moments)


@pytest.mark.parametrize(
    "words", [["setpoint", "speed"], ["nav.", "gyro"], ["speed", "nav."]], ids=" ".join
)
def test_what_one_of_two_logs_lacks_is_not_taken_for_zero(words):
    nothing_is_found(judged(pooled(sound(), only(sound(), *words))))


def test_set_points_that_begin_while_the_machine_drives_were_no_standstill():
    log = sound()
    late = {
        name: Channel(*(column[c.t_s > 10.0] for column in (c.t_s, c.values, c.span)))
        for name, c in log.channels.items()
        if "setpoint" in name
    }
    nothing_is_found(judged(log.with_channels(late)))


def lone_steps(values):
    """The rows before large steps with no other within half a second."""
    steps = np.abs(np.diff(values))
    return np.flatnonzero(
        (steps > 20.0) & (np.convolve(steps, np.ones(25), "same") == steps)
    )


def late_once(log, events=1):
    """The log whose set-points are, at its last steps, 0.2 s ahead of those that the wheels got."""
    ahead = {}
    for name in SETPOINTS:
        values = log[name].values.copy()
        for k in lone_steps(values)[-events:]:
            values[k - 9 : k + 1] = values[k + 1]
        ahead[name] = log[name].with_values(values)
    return log.with_channels(ahead)


def lost_in(log):
    drive = prepare_all(log, assembly().robot, 1, Tracker())[0]["drive"]
    return lost_steps(drive.problem, drive.base)


def test_lost_steps_are_looked_for_within_each_log():
    alone, both = (
        lost_in(log) for log in (sound(), pooled(moved(sound(), 1000.0), sound()))
    )
    assert alone[1] > 0
    assert both == (2 * alone[0], 2 * alone[1])


def test_a_step_that_is_over_within_a_sample_is_lost_all_the_same():
    late, judged_steps = lost_in(late_once(sound()))
    assert late == 4 < judged_steps


def test_one_event_of_four_wheels_is_chance_in_a_long_log():
    log = long()
    late, judged_steps = lost_in(late_once(log))
    assert judged_steps > 400
    assert late == 0
    assert lost_in(late_once(log, events=2))[0] == 8


@pytest.mark.parametrize("rows", [7, 9])
def test_speeds_that_all_stand_still_at_a_step_are_no_lost_set_point(rows):
    """The message of the speeds fails to come, for longer than the wheels take to answer."""
    log, held = sound(), {}
    t_s = log[SETPOINTS[0]].t_s[lone_steps(log[SETPOINTS[0]].values)[-1]]
    for name in SPEEDS:
        values = log[name].values.copy()
        first = np.searchsorted(log[name].t_s, t_s) - 1
        values[first : first + rows] = values[first]
        held[name] = log[name].with_values(values)
    assert lost_in(log)[1] - lost_in(log.with_channels(held))[1] == 4
    assert lost_in(log.with_channels(held))[0] == 0


def test_an_old_sample_at_a_step_is_no_lost_set_point():
    """Of rounded speeds nobody sees that one repeats the one before."""
    log, rng = sound(), np.random.default_rng(1)
    stale = {}
    for name in (n for n in log.channels if "speed" in n):
        rows = np.arange(len(log[name]))
        last = np.maximum.accumulate(np.where(rng.random(len(rows)) < 0.1, 0, rows))
        stale[name] = log[name].with_values(
            0.5 * np.round(2.0 * log[name].values)[last]
        )
    late, judged_steps = lost_in(log.with_channels(stale))
    assert judged_steps > 0
    assert late < FEWEST_EVENTS


def test_a_machine_that_was_asked_for_nothing_has_a_report():
    judged(held_at(sound(), ["setpoint"], 0.0))


@pytest.mark.parametrize("value", [0.0, 1e-9])
def test_channels_without_noise_overflow_nothing(value):
    judged(held_at(sound(), ["."], value))


@pytest.mark.parametrize(("seed", "duration_s"), [(1, 1.05), (3, 3.0), (1, 5.0)])
def test_a_recording_of_seconds_has_no_unknown_structure(seed, duration_s):
    """Its noise is hardly known: what looks like a gross misfit is not."""
    made = recipe("nothing drive", seed, duration_s)
    findings = judged(measured(make(made)[0]))
    assert findings.verdict == Overall.NOTHING_FOUND, said(findings)


def stood_still(seed=1):
    """The log of a machine that nobody drove: its sensors' noise about where it stood."""
    log = held_at(sound(), ["setpoint"], 0.0)
    rng = np.random.default_rng(seed)
    spread = {"speed": 0.12, "duty": 0.15, "nav.": 0.02, "gyro": 0.006}
    return log.with_channels(
        {
            name: c.with_values(rng.normal(0.0, sd, len(c)))
            for name, c in log.channels.items()
            for word, sd in spread.items()
            if word in name
        }
    )


def test_of_a_machine_that_stood_still_nothing_is_said_but_that():
    findings = judged(stood_still())
    assert findings.verdict == Overall.NOTHING_FOUND
    (finding,) = findings.findings
    assert finding.verdict == Verdict.INSUFFICIENT_EXCITATION
    assert "plan" in finding.separating_experiment
    assert [d.cause for d in findings.smallest_detectable] == ["gyro_bias"]
    told = {n.cause: n.reason for n in findings.not_judged}
    assert told["rotation_gain"] == "the robot stood still"
    assert "stood still" in summary(findings).splitlines()[0]


def test_a_machine_that_drove_and_one_that_stood_are_not_said_to_be_alike():
    findings = compare(sound(), stood_still(), assembly(), jobs=1).findings
    assert Verdict.INSUFFICIENT_EXCITATION in {f.verdict for f in findings.findings}
    assert "stood still" in summary(findings).splitlines()[0]
