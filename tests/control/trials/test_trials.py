"""A few trials of dead-man and Stop against a real daemon, with room for a busy computer."""

import pytest

from tests.control.robot import running_robot
from tests.control.trials import SOURCES
from tests.control.trials.terminal import TerminalRobot
from tests.control.trials.trials import SETTINGS, WHATS, Trials

TRIALS = 5
GENEROUS_MS = 250.0


@pytest.mark.long
@pytest.mark.parametrize("attack", ["idle", "browse15", "ctrl_s", "lock", "busy"])
@pytest.mark.parametrize("source", SOURCES)
def test_it_stops_in_time(tmp_path, source, attack):
    with (
        running_robot(tmp_path, TerminalRobot, **SETTINGS) as robot,
        Trials(robot, source, attack, seed=1) as trials,
    ):
        for what in WHATS:
            row = trials.row(what, TRIALS)
            assert not row.error
            assert len(row.late_ms) == TRIALS
            assert row.at(0.5) < GENEROUS_MS, row
