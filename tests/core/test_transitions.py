"""The table of the state machine: complete, and what `Control` does."""

import pytest

from hilserver.core.transitions import TRANSITIONS, Command, next_state
from hilserver.errors import ControlRefused
from hilserver.signals import State


def test_every_command_has_a_row_and_an_answer_in_every_state():
    assert set(TRANSITIONS) == set(Command)
    assert {len(row) for row in TRANSITIONS.values()} == {len(State)}


def test_the_safe_state_ends_by_reset_alone():
    out = {
        command
        for command, row in TRANSITIONS.items()
        if row[State.SAFE] not in (State.SAFE, State.STOPPING, None)
    }
    assert out == {Command.RESET}


def test_nothing_leaves_stopping():
    assert {row[State.STOPPING] for row in TRANSITIONS.values()} == {
        State.STOPPING,
        None,
    }


def test_from_every_state_the_daemon_can_go_to_the_safe_state_and_end():
    for state in set(State) - {State.STOPPING}:
        assert next_state(state, Command.FAULT) is State.SAFE
        assert next_state(state, Command.END) is State.STOPPING


def test_a_refusal_names_command_state_and_where_it_is_possible():
    with pytest.raises(ControlRefused) as refused:
        next_state(State.SAFE, Command.START)
    assert str(refused.value) == (
        "Start is not possible in state safe, only in state running or paused"
    )
