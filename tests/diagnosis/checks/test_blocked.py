"""A robot that is pushed against something: said and left out, and no cause of it is looked for."""

import numpy as np
import pytest

from hilserver.diagnosis.checks import blocked
from hilserver.measured.channels import GYRO, POSITION, SETPOINTS, SPEEDS, YAW
from tests.diagnosis.checks.samples import ROBOT, drive, log_of

FORWARD = (1.0, 1.0, -1.0, -1.0)
BEGIN_S, END_S = 41.3, 50.9


@pytest.fixture(scope="module")
def table():
    return drive(12, length_s=100.0)


def pushed(table, *, stalled=False, noise=1.0):
    """The drive with a spell at a wall: the wheels drive ahead, the rest stands."""
    t, columns = table
    rng, spell = np.random.default_rng(5), (t >= BEGIN_S) & (t < END_S)
    columns = {name: values.copy() for name, values in columns.items()}
    for name, sign in zip((*SETPOINTS, *SPEEDS), FORWARD * 2, strict=True):
        turns = 0.0 if stalled and name in SPEEDS else 40.0
        columns[name][spell] = sign * turns
    columns[GYRO][spell] = noise * 0.006 * rng.standard_normal(spell.sum())
    for name in (*POSITION, YAW):
        seen = np.isfinite(columns[name])
        there, later = spell & seen, (t >= END_S) & seen
        here = columns[name][there][0]
        columns[name][later] += here - columns[name][later][0]
        columns[name][there] = here + noise * 0.03 * rng.standard_normal(there.sum())
    return t, columns


@pytest.mark.parametrize(
    "stalled", [False, True], ids=["the wheels slip", "the wheels stall"]
)
@pytest.mark.parametrize("spans", [1, 3])
def test_a_blocked_spell_is_said_and_left_out(table, stalled, spans):
    log = log_of(*pushed(table, stalled=stalled), spans)
    kept, found = blocked.find(log, ROBOT)
    assert found == []
    (note,) = kept.notices
    assert note.startswith(
        "the robot stood still once although its wheels were turning"
    )
    assert len(kept.spans) == spans + 1
    for channel in kept.channels.values():
        assert not ((channel.t_s > BEGIN_S) & (channel.t_s < END_S)).any()
    left_s = sum(span.end_s - span.start_s for span in kept.spans)
    assert left_s > 100.0 - (END_S - BEGIN_S) - 8.0


def test_a_sound_drive_is_left_as_it_is(table):
    log = log_of(*table)
    assert blocked.find(log, ROBOT)[0] is log


def test_a_robot_on_a_frame_is_not_blocked_now_and_then(table):
    t, columns = table
    still = {n: np.where(np.isnan(columns[n]), np.nan, 0.3) for n in POSITION}
    log = log_of(t, {**columns, **still, GYRO: 0.0 * t})
    assert blocked.find(log, ROBOT)[0] is log


def test_without_position_or_turn_nothing_is_said(table):
    t, columns = pushed(table)
    for missing in (POSITION[0], GYRO):
        log = log_of(t, {n: v for n, v in columns.items() if n != missing})
        assert blocked.find(log, ROBOT)[0] is log
