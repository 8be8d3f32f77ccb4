"""The rules in virtual time: named, confirmed on the next window, decided, measured."""

from dataclasses import replace

import hypothesis
import pytest
from hypothesis import strategies as st

from hilserver.errors import ControlRefused
from hilserver.recalibration.loop import RecalibrationLoop, present
from hilserver.recalibration.orders import (
    JudgeOrder,
    JudgeResult,
    Looked,
    ModelsCompared,
    Share,
    Todo,
)
from hilserver.recalibration.proposals import (
    FOLLOWING,
    Proposal,
    ProposalStage,
    ProposalStep,
    ProposedTerm,
    Quantity,
)
from hilserver.recalibration.spending import Spending

WINDOW_S = 1800.0
GAIN = {"yaw_rad": Quantity(0.06, 0.01, 6.0, (4.0, 8.0))}
BETTER = ModelsCompared(1e-5, 1e-5, 72, GAIN)
NO_BETTER = ModelsCompared(0.4, 1e-5, 72, {"yaw_rad": Quantity(0.01, 0.01, 1.0)})
TERM = ProposedTerm(0.03, "1", (0.028, 0.032))
NAMED = Looked(
    "named",
    "The robot turns 3 % too little.",
    ("rotation_gain",),
    {"rotation_gain": TERM},
)
NOTHING = Looked("nothing")


class Robot:
    """A loop and its clock; windows are answered as they are asked."""

    def __init__(self, every_s=WINDOW_S):
        self.loop = RecalibrationLoop(every_s, Spending(), 0.0)
        self.window, self.loaded, self.notes = 0, {}, []

    def next(self, look=NOTHING, confirm=NO_BETTER, measure=NO_BETTER):
        self.window += 1
        now_s = self.window * WINDOW_S
        self.notes += self.loop.overtaken(self.loaded)
        todo = self.loop.todo(self.window, self.loaded, now_s)
        if todo is None:
            return None
        is_confirmed = todo.confirm is not None and confirm.holds(todo.level)
        result = JudgeResult(
            measure if todo.measure is not None else None,
            confirm if todo.confirm is not None else None,
            look if todo.look and not is_confirmed else None,
        )
        self.notes += self.loop.take(todo, result, now_s)
        return todo

    def proposed(self):
        self.next(NAMED)
        self.next(confirm=BETTER)
        assert self.loop.proposal.stage is ProposalStage.OPEN
        return self.loop.proposal

    def decide(self, step):
        decided = self.loop.decided(step, self.loop.proposal.number)
        self.loop.adopt(decided, self.window + 1)
        if step is ProposalStep.ACCEPT:
            self.loaded = {name: term.value for name, term in decided.terms.items()}

    @property
    def kinds(self):
        return [note.kind for note in self.notes]


def test_named_on_one_window_and_confirmed_on_the_next():
    robot = Robot()
    robot.next(NAMED)
    assert robot.loop.proposal is None
    todo = robot.next(confirm=BETTER)
    assert todo.confirm == {"rotation_gain": 0.03}
    proposal = robot.loop.proposal
    assert proposal.windows == (1, 2)
    assert proposal.gain == GAIN
    assert proposal.patch == "recalibrated-0001.yaml"
    assert proposal.former == "recalibrated-0001-former.yaml"
    assert robot.kinds == ["look", "confirmation", "proposal"]


def test_named_twice_and_never_confirmed_is_no_proposal():
    robot = Robot()
    for _ in range(20):
        robot.next(NAMED, confirm=NO_BETTER)
    assert robot.loop.proposal is None
    verdicts = {n.fields["verdict"] for n in robot.notes if n.kind == "confirmation"}
    assert verdicts == {"not_confirmed"}


def test_too_few_blocks_are_no_test_and_the_history_says_so():
    robot = Robot()
    robot.next(NAMED)
    robot.next(confirm=ModelsCompared(2.0**-6, 2.0**-6, 6, GAIN))
    assert robot.loop.proposal is None
    assert robot.notes[1].fields["verdict"] == "no_test"
    assert robot.notes[1].fields["resolution"] == 2.0**-6
    why = robot.notes[1].fields["sentence"]
    assert why.startswith("In 6 stretches of window 2 the robot moved")
    assert why.endswith("it takes 8 to say which is better.")


def test_a_window_that_went_by_while_a_look_was_slow_is_no_loss():
    robot = Robot()
    robot.next(NAMED)
    robot.window += 1
    assert robot.next(confirm=BETTER).confirm is not None
    assert robot.loop.proposal.windows == (1, 3)


def test_a_model_that_changed_meanwhile_takes_it_away():
    robot = Robot()
    robot.next(NAMED)
    robot.loaded = {"wheel_radius": 0.01}
    assert robot.next(confirm=BETTER).confirm is None


def test_without_a_change_it_looks_as_seldom_as_configured():
    robot = Robot(every_s=10 * WINDOW_S)
    assert [robot.next() is not None for _ in range(20)].count(True) == 2
    robot.loop.changed = "nav.x_m"
    assert robot.next().look
    assert robot.loop.changed is None


def test_the_gap_after_a_decision_is_measured_on_a_window_of_its_own():
    robot = Robot(every_s=None)
    robot.loop.changed = "nav.x_m"
    robot.proposed()
    robot.decide(ProposalStep.ACCEPT)
    assert robot.next() is None  # it began before
    todo = robot.next(measure=BETTER)
    assert todo.measure == {}
    assert robot.loop.proposal.stage is ProposalStage.BETTER
    assert robot.loop.proposal.effect == GAIN


def test_a_decision_that_did_not_help_offers_the_former_model():
    robot = Robot(every_s=None)
    robot.loop.changed = "nav.x_m"
    robot.loaded = {"rotation_gain": 0.01, "nav_latency": 0.1}
    terms = {"rotation_gain": replace(TERM, present=0.01)}
    robot.next(replace(NAMED, terms=terms, gone={"nav_latency": 0.1}))
    robot.next(confirm=BETTER)
    robot.decide(ProposalStep.ACCEPT)
    robot.next()
    assert robot.next(measure=NO_BETTER).measure == {
        "rotation_gain": 0.01,
        "nav_latency": 0.1,
    }
    offered = robot.loop.proposal
    assert offered.stage is ProposalStage.OPEN
    assert {n: t.value for n, t in offered.terms.items()} == {
        "rotation_gain": 0.01,
        "nav_latency": 0.1,
    }
    assert offered.patch == "recalibrated-0001-former.yaml"
    assert present(offered) == {"rotation_gain": 0.03}


def test_a_window_that_cannot_say_leaves_the_effect_to_the_next():
    """The robot stood still: no block differs, and the former model is not offered for that."""
    robot = Robot()
    robot.proposed()
    robot.decide(ProposalStep.ACCEPT)
    robot.next()
    robot.next(measure=ModelsCompared(1.0, 1.0, 0))
    assert robot.notes[-2].fields["verdict"] == "too_short"
    assert (
        robot.notes[-2]
        .fields["sentence"]
        .startswith("In 0 stretches of window 4 the robot")
    )
    assert robot.loop.proposal.stage is ProposalStage.ACCEPTED
    robot.next(measure=BETTER)
    assert robot.loop.proposal.stage is ProposalStage.BETTER


@pytest.mark.parametrize("loaded", [{}, {"rotation_gain": 0.03, "nav_latency": 0.1}])
def test_what_no_longer_runs_as_it_was_accepted_is_not_measured(loaded):
    robot = Robot(every_s=None)
    robot.loop.changed = "nav.x_m"
    robot.proposed()
    robot.decide(ProposalStep.ACCEPT)
    robot.next()
    robot.loaded = loaded
    assert robot.next() is None
    assert robot.loop.proposal.stage is ProposalStage.REPLACED
    assert robot.notes[-1].fields["proposal"]["stage"] == "replaced"
    n = len(robot.notes)
    assert robot.next() is None
    assert len(robot.notes) == n


def test_two_models_of_which_none_is_better_do_not_take_turns():
    robot = Robot()
    robot.proposed()
    robot.decide(ProposalStep.ACCEPT)
    robot.next()
    robot.next()
    assert robot.loop.proposal.number == 2
    robot.decide(ProposalStep.ACCEPT)
    robot.next()
    robot.next()
    assert (robot.loop.proposal.number, robot.loop.proposal.stage) == (
        2,
        ProposalStage.NOT_BETTER,
    )


def test_what_was_rejected_is_not_proposed_again():
    robot = Robot()
    robot.proposed()
    robot.decide(ProposalStep.REJECT)
    robot.next(NAMED)
    robot.next(confirm=BETTER)
    assert robot.loop.proposal.stage is ProposalStage.REJECTED
    other = replace(
        NAMED, terms={"rotation_gain": ProposedTerm(0.06, "1", (0.05, 0.07))}
    )
    robot.next(other)
    robot.next(confirm=BETTER)
    assert robot.loop.proposal.stage is ProposalStage.OPEN


def test_what_was_rejected_for_another_model_is_proposed_for_this_one():
    robot = Robot()
    robot.proposed()
    robot.decide(ProposalStep.REJECT)
    robot.loaded = {"rotation_gain": 0.01}
    robot.next(replace(NAMED, terms={"rotation_gain": replace(TERM, present=0.01)}))
    robot.next(confirm=BETTER)
    assert robot.loop.proposal.stage is ProposalStage.OPEN


def test_a_newer_proposal_replaces_an_open_one():
    robot = Robot()
    robot.proposed()
    robot.next(
        replace(NAMED, terms={"rotation_gain": ProposedTerm(0.06, "1", (0.05, 0.07))})
    )
    robot.next(confirm=BETTER)
    assert robot.loop.proposal.number == 2
    assert robot.kinds[-3:] == ["confirmation", "decision", "proposal"]


def test_faults_of_the_data_are_said_and_never_proposed():
    robot = Robot()
    robot.next(Looked("data_fault", faults=("nav.x_m has stood still.",)))
    assert robot.next(confirm=BETTER).confirm is None
    assert ("data_fault", "nav.x_m has stood still.") in [
        (n.kind, n.sentence) for n in robot.notes
    ]


def test_a_look_that_failed_is_said_and_forgotten():
    robot = Robot()
    robot.next(NAMED)
    todo = robot.loop.todo(2, {}, 2 * WINDOW_S)
    notes = robot.loop.take(todo, JudgeResult(error="it was killed"), 2 * WINDOW_S)
    assert notes[0].sentence == "window 2 could not be diagnosed: it was killed"
    assert robot.loop.todo(3, {}, 3 * WINDOW_S).confirm is None


def test_a_restart_restores_what_waits_and_what_was_rejected():
    robot = Robot()
    robot.proposed()
    lines = [note.fields for note in robot.notes]
    after = RecalibrationLoop(WINDOW_S, Spending(), 0.0)
    after.restore(lines, {}, 2)
    assert after.proposal == robot.loop.proposal
    robot.decide(ProposalStep.ACCEPT)
    lines.append({"proposal": robot.loop.proposal.as_json()})
    after.restore(lines, {}, 2)
    assert (
        after.proposal.stage is ProposalStage.OPEN
    )  # the daemon runs the configuration again
    after.restore(lines, robot.loaded, 2)
    assert (
        after.proposal.stage is ProposalStage.ACCEPTED
    )  # it was started with its patch
    assert after.todo(3, robot.loaded, 3 * WINDOW_S).measure == {}


@pytest.mark.parametrize(
    "step", [ProposalStep.ACCEPT, ProposalStep.REJECT, ProposalStep.POSTPONE]
)
def test_only_the_newest_can_be_decided_on_and_once(step):
    robot = Robot()
    number = robot.proposed().number
    with pytest.raises(
        ControlRefused, match=r"7 is not the latest proposal: that is 1"
    ):
        robot.loop.decided(step, 7)
    robot.decide(step)
    with pytest.raises(ControlRefused, match=r"proposal 1 is"):
        robot.loop.decided(step, number)


STEPS = st.lists(st.sampled_from(ProposalStep), max_size=8)


@hypothesis.given(steps=STEPS)
def test_nothing_follows_a_rejection_and_nothing_is_accepted_that_is_not_open(steps):
    proposal = Proposal(1, (), "", {})
    for step in steps:
        before = proposal.stage
        try:
            proposal = proposal.after(step)
        except ControlRefused:
            assert before not in FOLLOWING[step][0]
            continue
        assert before is not ProposalStage.REJECTED
        if proposal.stage is ProposalStage.ACCEPTED:
            assert before in (ProposalStage.OPEN, ProposalStage.POSTPONED)


TERMS = st.dictionaries(
    st.sampled_from(["rotation_gain", "wheel_radius", "nav_latency"]),
    st.builds(
        ProposedTerm,
        st.floats(-1, 1),
        st.just("1"),
        st.none(),
        st.none() | st.floats(-1.0, 1.0),
    ),
    max_size=3,
)


@hypothesis.given(
    terms=TERMS, gone=st.dictionaries(st.just("gyro_bias"), st.floats(-1, 1))
)
def test_a_proposal_survives_its_file(terms, gone):
    proposal = Proposal(3, ("a", "b"), "text", terms, gone, GAIN, windows=(1, 2))
    assert Proposal.from_json(proposal.as_json()) == proposal


def test_orders_and_results_survive_the_pipe():
    todo = Todo(3, {"rotation_gain": 0.1}, {}, None, 0.001, look=True)
    order = JudgeOrder(
        todo,
        "/w",
        {"plant": {}},
        "/",
        {"plant.track_m": 0.3},
        "/r",
        Share(15, (1,), 2**30, 7),
    )
    assert JudgeOrder.of(order.text()) == order
    result = JudgeResult(BETTER, None, NAMED)
    assert JudgeResult.of(result.text()) == result


@pytest.mark.parametrize(
    ("ranges", "is_within"),
    [
        ({"a": (0.0, 0.1)}, False),
        ({"a": (0.0, 0.1), "gone": (0, 0)}, True),
        ({}, False),
    ],
)
def test_what_acts_by_itself_lies_within_ranges(ranges, is_within):
    terms = {"a": ProposedTerm(0.03, "1"), "kept": ProposedTerm(0.5, "1", None, 0.5)}
    proposal = Proposal(1, (), "", terms, {"gone": 0.1})
    assert proposal.within(ranges) == is_within
    assert not Proposal(1, (), "", {"a": ProposedTerm(0.2, "1")}).within(
        {"a": (0.0, 0.1)}
    )
