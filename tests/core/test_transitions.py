"""The table of the state machine: complete, as the page prints it, and what `Control` does."""

from pathlib import Path

import pytest

from hilserver.core.transitions import MEANING, TRANSITIONS, Command, as_markdown, next_state
from hilserver.errors import ControlRefused
from hilserver.signals import State

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "states.md"


def test_every_command_has_a_row_a_meaning_and_an_answer_in_every_state():
    assert set(TRANSITIONS) == set(MEANING) == set(Command)
    assert {len(row) for row in TRANSITIONS.values()} == {len(State)}


def test_the_safe_state_ends_by_reset_alone():
    out = {
        command
        for command, row in TRANSITIONS.items()
        if row[State.SAFE] not in (State.SAFE, State.STOPPING, None)
    }
    assert out == {Command.RESET}


def test_nothing_leaves_stopping():
    assert {row[State.STOPPING] for row in TRANSITIONS.values()} == {State.STOPPING, None}


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


def test_the_page_is_the_one_that_make_reference_writes():
    assert PAGE.read_text(encoding="utf-8") == as_markdown(), "run 'make reference'"
