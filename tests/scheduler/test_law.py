"""The law: properties over random delays for every policy, and plain examples."""

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.scheduler import law as law_words
from hilserver.scheduler.law import (
    CONSECUTIVE,
    EXECUTED,
    LATE_WAKES,
    LONG_RUNS,
    MISSED_TOTAL,
    OK,
    PLANNED,
    SHIFTED_TOTAL,
    STOP,
)
from hilserver.scheduler.policies import (
    POLICY_NAMES,
    OverrunLimits,
    OverrunPolicy,
    catch_up_shift_ns,
    fail_shift_ns,
    skip_shift_ns,
    stretch_shift_ns,
)
from tests.scheduler.followed_law import Law

PERIOD = 1000
durations = st.one_of(st.integers(0, PERIOD), st.integers(0, 12 * PERIOD))
# (delay of the wake-up, execution) per tick
histories = st.lists(st.tuples(durations, durations), min_size=1, max_size=60)


class Run:
    """Drives the law through a history as a back end would, and notes what it said."""

    def __init__(self, policy, history, limit=3, limits=None, first_planned_ns=5000):
        self.law = Law(
            base_period_ns=PERIOD,
            period_ticks=(1, 2, 5),
            policy=OverrunPolicy(policy, limit),
            limits=limits,
            first_planned_ns=first_planned_ns,
        )
        self.decisions, self.kinds, self.verdicts, self.grid = [], [], [], []
        now = 0
        for delay, execution in history:
            planned = int(self.law.state[PLANNED])
            if now <= planned:  # it slept, and woke late by `delay`
                assert not self.law.advance(planned - 1).run
                now = planned + delay
            self.grid.append(planned)
            self.decisions.append(self.law.advance(now))
            now += execution
            kind, verdict = self.law.conclude(now)
            self.kinds.append(kind)
            self.verdicts.append(verdict)
            if verdict == STOP:
                break

    def total(self, word):
        return int(self.law.state[word])


@pytest.mark.parametrize("policy", POLICY_NAMES)
@given(history=histories)
def test_no_tick_is_lost_or_doubled(policy, history):
    run = Run(policy, history)
    assert all(decision.run for decision in run.decisions)
    assert [d.tick for d in run.decisions] == list(range(len(run.decisions)))
    assert run.total(EXECUTED) == len(run.decisions)
    for d in run.decisions:
        assert d.due == tuple(
            i for i, ticks in enumerate((1, 2, 5)) if d.tick % ticks == 0
        )


@pytest.mark.parametrize("policy", POLICY_NAMES)
@given(history=histories)
def test_planned_grid_only_moves_forward_by_whole_periods_plus_the_shift(
    policy, history
):
    run = Run(policy, history)
    stamps = [d.planned_ns for d in run.decisions]
    for i, (before, after) in enumerate(itertools.pairwise(stamps), start=1):
        assert after == before + PERIOD + run.decisions[i].shift_ns
    assert all(d.shift_ns >= 0 for d in run.decisions)
    assert run.total(SHIFTED_TOTAL) == sum(d.shift_ns for d in run.decisions)


@pytest.mark.parametrize("policy", POLICY_NAMES)
@given(history=histories)
def test_counts_add_up(policy, history):
    run = Run(policy, history)
    assert run.total(MISSED_TOTAL) == sum(d.missed for d in run.decisions)
    assert run.total(LATE_WAKES) == run.kinds.count("late_wake")
    assert run.total(LONG_RUNS) == run.kinds.count("long_run")


@pytest.mark.parametrize("policy", ["catch_up", "skip"])
@given(history=histories)
def test_grid_keeps_its_phase_and_every_planned_start_is_used_or_missed(
    policy, history
):
    run = Run(policy, history)
    assert all((d.planned_ns - 5000) % PERIOD == 0 for d in run.decisions)
    last = run.decisions[-1]
    assert (last.planned_ns - 5000) // PERIOD == last.tick + run.total(MISSED_TOTAL)


@given(history=histories)
def test_skip_never_starts_a_whole_period_late(history):
    for start, d in zip(
        Run("skip", history).grid, Run("skip", history).decisions, strict=True
    ):
        assert 0 <= start + d.latency_ns - d.planned_ns < PERIOD


@given(history=histories, limit=st.integers(0, 6))
def test_catch_up_is_never_further_behind_than_its_limit(history, limit):
    run = Run("catch_up", history, limit)
    for planned, d in zip(run.grid, run.decisions, strict=True):
        behind = (planned + d.latency_ns - d.planned_ns) // PERIOD
        assert behind <= limit
        assert d.missed == max(0, d.latency_ns // PERIOD - limit)


@given(history=histories)
def test_stretch_never_misses(history):
    run = Run("stretch", history)
    assert run.total(MISSED_TOTAL) == 0
    for planned, d in zip(run.grid, run.decisions, strict=True):
        assert d.shift_ns == (d.latency_ns if d.latency_ns >= PERIOD else 0)
        assert planned + d.latency_ns - d.planned_ns < PERIOD


@given(history=histories)
def test_fail_stops_at_the_first_overrun_and_not_before(history):
    run = Run("fail", history)
    overruns = [kind != "none" for kind in run.kinds]
    assert [verdict == STOP for verdict in run.verdicts] == overruns
    assert not any(overruns[:-1])


@given(history=histories)
def test_a_wake_in_time_with_short_work_is_never_an_overrun(history):
    run = Run("catch_up", [(d % 400, e % 400) for d, e in history])
    assert set(run.kinds) == {"none"}
    assert run.total(MISSED_TOTAL) == 0


@given(history=histories, limit=st.integers(1, 5))
def test_consecutive_limit_fires_after_exactly_so_many(history, limit):
    run = Run("skip", history, limits=OverrunLimits(consecutive=limit))
    in_a_row = 0
    for i, kind in enumerate(run.kinds):
        if kind != "none":
            in_a_row += 1
        elif (
            run.grid[i] + PERIOD
            >= run.grid[i] + run.decisions[i].latency_ns + history[i][1]
        ):
            in_a_row = 0  # ended in time
        assert (run.verdicts[i] == 2) == (kind != "none" and in_a_row == limit)
        if in_a_row == limit:
            in_a_row = 0
        assert run.verdicts[i] in (OK, 2)


def test_two_kinds_are_told_apart():
    assert Run("skip", [(1500, 10)]).kinds == ["late_wake"]
    assert Run("skip", [(10, 1500)]).kinds == ["long_run"]
    assert Run("skip", [(600, 500)]).kinds == ["late_wake"]
    assert Run("skip", [(500, 600)]).kinds == ["long_run"]
    # the deadline itself is still in time
    assert Run("skip", [(1000, 0)]).kinds == ["none"]


def test_backlog_of_a_long_run_is_not_blamed_on_the_ticks_behind_it():
    run = Run("catch_up", [(0, 3500), (0, 10), (0, 10), (0, 10), (0, 10)])
    assert run.kinds == ["long_run", "none", "none", "none", "none"]
    assert [d.backlog for d in run.decisions] == [False, True, True, True, False]
    assert [d.latency_ns for d in run.decisions[:4]] == [0, 2500, 1510, 520]


def test_timelines_of_the_policies():
    long_run = [(0, 3500), (0, 10), (0, 10), (0, 10)]
    starts = {
        p: [d.planned_ns for d in Run(p, long_run, 1).decisions] for p in POLICY_NAMES
    }
    assert starts["catch_up"] == [5000, 7000, 8000, 9000]
    assert starts["skip"] == [5000, 8000, 9000, 10000]
    assert starts["stretch"] == [5000, 8500, 9500, 10500]
    assert starts["fail"] == [5000]


def test_shifts_are_pure_arithmetic():
    assert catch_up_shift_ns(7999, 1000, 5) == 2000
    assert catch_up_shift_ns(5999, 1000, 5) == 0
    assert skip_shift_ns(7999, 1000, 0) == 7000
    assert stretch_shift_ns(7999, 1000, 0) == 7999
    assert fail_shift_ns(7999, 1000, 0) == 0


def test_single_limit_asks_for_the_safe_state():
    run = Run("skip", [(1600, 10), (1300, 10)], limits=OverrunLimits(single_ns=500))
    assert run.verdicts == [1, OK]


def test_a_pause_is_no_overrun_and_keeps_the_tick():
    law = Law(base_period_ns=PERIOD, first_planned_ns=5000)
    law.advance(5000)
    law.conclude(5010)
    for now in (6003, 7001, 9500):
        law.hold(now)
    planned = int(law.state[PLANNED])
    assert planned == 10_000
    decision = law.advance(planned)
    assert (decision.tick, decision.missed, decision.latency_ns) == (1, 0, 0)
    assert law.conclude(planned + 10) == ("none", OK)
    assert law.state[CONSECUTIVE] == 0


def test_warm_up_is_neither_counted_nor_judged():
    law = Law(base_period_ns=PERIOD, policy=OverrunPolicy("fail"), warm_up_ticks=2)
    for delay, execution in ((9000, 1500), (2000, 900)):
        now = int(law.state[PLANNED]) + delay
        law.advance(now)
        assert law.conclude(now + execution) == ("none", OK)
    assert (law.state[MISSED_TOTAL], law.state[LATE_WAKES], law.state[LONG_RUNS]) == (
        0,
        0,
        0,
    )
    now = int(law.state[PLANNED]) + 9000
    law.advance(now)
    assert law.conclude(now) == ("late_wake", STOP)


@settings(max_examples=20)
@given(speed=st.lists(st.integers(1, 5000), min_size=5, max_size=50))
def test_changed_period_moves_only_what_comes_next(speed):
    law = Law(base_period_ns=PERIOD, first_planned_ns=0)
    expected = 0
    for period in speed:
        law.state[law_words.PERIOD] = period
        assert law.advance(expected).planned_ns == expected
        law.conclude(expected)
        expected += period
        assert law.state[PLANNED] == expected


def test_bad_policies_and_limits_are_refused():
    with pytest.raises(ValueError, match="one of catch_up, skip, stretch, fail"):
        OverrunPolicy("hurry")
    with pytest.raises(ValueError, match="negative"):
        OverrunPolicy("catch_up", -1)
    with pytest.raises(ValueError, match="negative"):
        OverrunLimits(single_ns=-1)
