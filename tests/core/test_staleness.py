"""Staleness in virtual time."""

from hypothesis import given
from hypothesis import strategies as st

from hilserver.core.staleness import Staleness, Transition

LIMIT = 500


def test_never_heard_is_stale_but_not_lost():
    watch = Staleness(LIMIT)
    assert [watch.check(now) for now in (0, 499, 501, 10_000)] == [None] * 4
    assert watch.stale
    assert watch.reason == "never heard"


def test_first_lost_restored():
    watch = Staleness(LIMIT)
    watch.renew(100)
    assert watch.check(100) is Transition.FIRST
    assert watch.check(600) is None
    assert watch.check(601) is Transition.LOST
    watch.renew(700)
    assert watch.check(700) is Transition.RESTORED
    assert not watch.stale


def test_one_unusable_input_makes_the_peer_stale():
    watch = Staleness(LIMIT)
    watch.renew(0)
    watch.check(0)
    watch.unusable("wheel.rr.setpoint_rpm", 10)
    for now in range(20, 510, 10):
        watch.renew(now)
        watch.unusable("wheel.rr.setpoint_rpm", now)
        assert watch.check(now) is None
    watch.renew(511)
    assert watch.check(511) is Transition.LOST
    assert "wheel.rr.setpoint_rpm" in watch.reason
    watch.usable("wheel.rr.setpoint_rpm")
    assert watch.check(512) is Transition.RESTORED


def test_a_peer_is_waited_for_until_every_commanding_input_had_a_value():
    watch = Staleness(LIMIT, ["wheel.fl.setpoint_rpm"])
    watch.unusable("wheel.fl.setpoint_rpm", 0)
    watch.unusable("measured.pose.x_m", 0)
    for now in range(
        0, 20 * LIMIT, LIMIT // 2
    ):  # the server answers, the node is not there
        watch.renew(now)
        assert watch.check(now) is None
    assert watch.waiting
    assert watch.reason == "wheel.fl.setpoint_rpm has no usable value yet"
    watch.usable("wheel.fl.setpoint_rpm")
    watch.usable("measured.pose.x_m")
    watch.renew(now)
    assert not watch.waiting
    assert watch.check(now) is Transition.FIRST


def test_a_lost_peer_is_not_restored_by_a_server_without_values():
    watch = Staleness(LIMIT, ["wheel.fl.setpoint_rpm"])
    watch.renew(0)
    watch.check(0)
    assert watch.check(LIMIT + 1) is Transition.LOST
    watch.unusable("wheel.fl.setpoint_rpm", LIMIT + 2)  # a new session, no value so far
    watch.renew(LIMIT + 3)
    assert watch.check(LIMIT + 3) is None
    assert watch.waiting
    watch.usable("wheel.fl.setpoint_rpm")
    watch.renew(LIMIT + 4)
    assert watch.check(LIMIT + 4) is Transition.RESTORED


def test_a_loop_that_stood_still_is_named_instead_of_the_peer():
    watch = Staleness(LIMIT)
    watch.renew(0)
    watch.check(0)
    assert watch.check(LIMIT + 1) is Transition.LOST
    assert watch.reason.startswith("the daemon's event loop was blocked for")


@given(st.lists(st.tuples(st.integers(1, 2 * LIMIT), st.booleans()), max_size=60))
def test_stale_exactly_when_nothing_came_for_the_limit(steps):
    watch, now, heard = Staleness(LIMIT), 0, None
    lost = restored = 0
    for pause, speaks in steps:
        now += pause
        if speaks:
            watch.renew(now)
            heard = now
        transition = watch.check(now)
        lost += transition is Transition.LOST
        restored += transition is Transition.RESTORED
        assert watch.stale == (heard is None or now - heard > LIMIT)
    assert lost - restored in (0, 1)
