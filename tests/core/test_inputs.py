"""The gate: nothing unchecked gets to the plant."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.core.events import EventBus, EventKind
from hilserver.core.refusal import Refusal, check_value
from hilserver.errors import ControlRefused
from hilserver.signals import robot_table
from hilserver.status import GOOD, UNCERTAIN_LAST_USABLE_VALUE
from tests.fakes import (
    RANGES,
    ManualClock,
    latch_inputs,
    make_gate,
    make_image,
    make_table,
)


@pytest.fixture
def world():
    table, clock, events = make_table(), ManualClock(), EventBus()
    image = make_image(table, queue_rows=16)
    gate = make_gate(table, image, events, owner="peer", monotonic_ns=clock)
    yield gate, image, events, clock
    image.close()


def latched(image, name, tick=0):
    latch_inputs(image, tick)
    return image.frame_values[make_table().slot(name)]


def test_accepted_values_reach_the_frame_at_the_next_latch(world):
    gate, image, _, _ = world
    assert gate.write("peer:iot2050", {"wheel.fl.setpoint_rpm": 12.5}) == {}
    slot = make_table().slot("wheel.fl.setpoint_rpm")
    assert image.frame_values[slot] == 0.0
    assert latched(image, "wheel.fl.setpoint_rpm") == 12.5


def test_of_scalar_and_array_the_later_write_wins(world):
    gate, image, _, _ = world
    gate.write("peer:a", {"wheels.setpoints_rpm": [1.0, 2.0, 3.0, 4.0]})
    gate.write("peer:a", {"wheel.rl.setpoint_rpm": 20.0})
    assert latched(image, "wheel.rl.setpoint_rpm") == 20.0
    gate.write("peer:a", {"wheel.rl.setpoint_rpm": 20.0})
    gate.write("peer:a", {"wheels.setpoints_rpm": [1.0, 2.0, 3.0, 4.0]})
    assert latched(image, "wheel.rl.setpoint_rpm") == 2.0


def test_a_source_without_control_is_reported_once_per_change(world):
    gate, _, events, _ = world
    for rpm in range(5):
        gate.write(
            "opcua", {"wheel.fl.setpoint_rpm": rpm, "wheel.fr.setpoint_rpm": -rpm}
        )
    assert len(events.recent) == 1
    assert "'peer' has control" in events.recent[-1].message
    assert "write 'opcua' to control.source to take it" in events.recent[-1].message
    assert gate.rejected["opcua", "not_in_control"] == 10
    gate.take("page")
    gate.write("opcua", {"wheel.fl.setpoint_rpm": 1.0})
    assert "'page' has control" in events.recent[-1].message
    gate.take("opcua")
    gate.write("opcua", {"wheel.fl.setpoint_rpm": 1.0})
    gate.take("page")
    gate.write("opcua", {"wheel.fl.setpoint_rpm": 1.0})
    assert "'page' has control" in events.recent[-1].message


@pytest.mark.parametrize("source", ["peer:a", "opcua"])
@pytest.mark.parametrize("driver", ["peer", "opcua"])
def test_a_command_that_came_in_before_every_lease_ended_is_none(world, driver, source):
    gate, image, _, clock = world
    gate.take(driver)
    before_ns = clock()
    clock.pass_s(1.0)
    gate.end()
    command = {"wheel.fl.setpoint_rpm": 12.5}
    assert gate.write(source, command, received_ns=before_ns) == {
        "wheel.fl.setpoint_rpm": "outdated"
    }
    gate.take(source.partition(":")[0])
    assert latched(image, "wheel.fl.setpoint_rpm") == 0.0
    assert gate.write(source, {"measured.pose.x_m": 1.0}, received_ns=before_ns) == {}
    assert gate.write(source, command) == {}
    assert latched(image, "wheel.fl.setpoint_rpm") == 12.5


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("drive.enable", 1.0, "a value of type Boolean expected"),
        ("wheel.fl.setpoint_rpm", True, "a value of type Double expected"),
        ("wheels.setpoints_rpm", 1.0, "4 values of type Double expected"),
    ],
)
def test_a_wrong_type_names_the_type_wanted(world, name, value, wanted):
    gate, _, events, _ = world
    gate.write("peer:a", {name: value})
    assert wanted in events.recent[-1].message


@pytest.mark.parametrize(
    ("name", "value", "refusal"),
    [
        ("wheel.fl.setpoint_rpm", math.nan, Refusal.NOT_FINITE),
        ("wheel.fl.setpoint_rpm", -math.inf, Refusal.NOT_FINITE),
        ("wheel.fl.setpoint_rpm", 90.1, Refusal.OUT_OF_RANGE),
        ("wheel.fl.setpoint_rpm", "12", Refusal.TYPE_MISMATCH),
        ("wheel.fl.setpoint_rpm", True, Refusal.TYPE_MISMATCH),
        ("wheel.fl.setpoint_rpm", None, Refusal.TYPE_MISMATCH),
        ("wheels.setpoints_rpm", [1.0, 2.0, 3.0], Refusal.TYPE_MISMATCH),
        ("wheels.setpoints_rpm", 1.0, Refusal.TYPE_MISMATCH),
        ("wheels.setpoints_rpm", [1.0, 2.0, 3.0, math.nan], Refusal.NOT_FINITE),
        ("drive.enable", 1, Refusal.TYPE_MISMATCH),
        ("control.mode", 3, Refusal.OUT_OF_RANGE),
        ("control.mode", 0.5, Refusal.TYPE_MISMATCH),
        pytest.param(
            "wheel.fl.setpoint_rpm", 10**400, Refusal.NOT_FINITE, id="400 digits"
        ),
        ("pose.x_m", 1.0, Refusal.NOT_WRITABLE),
        ("internal.command", 1.0, Refusal.UNKNOWN_SIGNAL),
        ("no.such_signal", 1.0, Refusal.UNKNOWN_SIGNAL),
    ],
)
def test_refused_values_change_nothing_and_are_told(world, name, value, refusal):
    gate, image, events, _ = world
    before = image.frame_values.copy()
    assert gate.write("peer:a", {name: value}) == {name: refusal}
    latch_inputs(image)
    assert (image.frame_values == before).all()
    assert gate.rejected[("peer:a", refusal.value)] == 1
    assert events.recent[-1].kind is EventKind.SETPOINT_REFUSED
    assert name in events.recent[-1].message


def test_names_that_clients_make_become_no_series(world):
    """Each visit to the page has a source of its own; one refused write each is no new series."""
    gate, *_ = world
    gate.take("page")
    before = set(gate.rejected)
    assert {reason for source, reason in before if source == "page"} == set(Refusal) - {
        Refusal.NOT_GRANTED,  # of doors without a log-in
        Refusal.NOT_STARTED,  # of automatic sources
        Refusal.INCOMPLETE,  # the value that was wrong counts
    }
    for visit in range(100):
        gate.write(f"page:{visit}", {"wheel.fl.setpoint_rpm": math.nan})
        gate.write(f"page:{visit}", {"wheel.fl.setpoint_rpm": 1.0})
    assert set(gate.rejected) == before
    assert gate.rejected["page", "not_finite"] == 100
    assert gate.sources == ("page",)
    assert gate.age_s("page:7") == gate.age_s("page")


def test_what_is_remembered_of_refused_sources_has_a_limit(world):
    gate, _, events, _ = world
    for visit in range(1000):
        gate.write(f"page:{visit}", {"wheel.fl.setpoint_rpm": 1.0})
    assert len(gate._denied) <= 64
    assert gate.rejected["page", "not_in_control"] == 1000
    assert events.recent[-1].source == "page:999", "each one is told"


WHEELS = [f"wheel.{wheel}.setpoint_rpm" for wheel in ("fl", "rl", "fr", "rr")]
TWIST = ["twist.linear_m_s", "twist.angular_rad_s"]
DUTIES = [f"wheel.{wheel}.duty_command_pct" for wheel in ("fl", "rl", "fr", "rr")]


@pytest.mark.parametrize("command", [WHEELS, TWIST, DUTIES])
@pytest.mark.parametrize("wrong", [math.nan, 1e9, "12"])
def test_a_command_is_whole_or_not_at_all(world, command, wrong):
    gate, image, events, _clock = world
    gate.write("peer:a", dict.fromkeys(command, 0.1) | {"control.mode": 0})
    latch_inputs(image)
    before = image.frame_values.copy()
    others = {"measured.pose.x_m": 2.0, "lights.red": 3, "drive.enable": False}
    refused = gate.write(
        "peer:a",
        dict.fromkeys(command, 0.2) | {command[-1]: wrong, "control.mode": 1} | others,
    )
    assert refused.pop(command[-1]) is not Refusal.INCOMPLETE
    assert refused == dict.fromkeys([*command[:-1], "control.mode"], "incomplete")
    latch_inputs(image)
    table = make_table()
    for name in (*command, "control.mode"):
        assert image.frame_values[table.slot(name)] == before[table.slot(name)]
    assert image.frame_values[table.slot("measured.pose.x_m")] == 2.0
    assert image.frame_values[table.slot("lights.red")] == 3.0
    assert image.frame_values[table.slot("drive.enable")] == 0.0
    assert len(events.recent) == 1, "the value that is wrong, not those beside it"
    assert sum(gate.rejected.values()) == 1


def test_commands_of_one_request_that_need_not_each_other(world):
    gate, image, *_ = world
    both = dict.fromkeys(WHEELS, 5.0) | dict.fromkeys(TWIST, 0.1)
    refused = gate.write("peer:a", both | {TWIST[0]: math.nan})
    assert refused == {TWIST[0]: "not_finite", TWIST[1]: "incomplete"}
    assert latched(image, WHEELS[3]) == 5.0
    refused = gate.write("peer:a", both | {"control.mode": 7})
    assert set(refused) == {*both, "control.mode"}, "which of them acts is not known"
    assert gate.write("peer:a", {WHEELS[0]: math.nan}).keys() == {WHEELS[0]}
    assert gate.write("peer:a", {WHEELS[1]: 6.0}) == {}, "requests are separate"


def test_what_is_wrong_elsewhere_in_a_request_counts(world):
    gate, _image, *_ = world
    wheels = dict.fromkeys(WHEELS[:3], 5.0)
    for broken in (WHEELS[3], "wheels.setpoints_rpm", "control.mode", "no.such_signal"):
        refused = gate.write("peer:a", wheels, broken=[broken])
        assert refused == dict.fromkeys(wheels, "incomplete")
    refused = gate.write("peer:a", {**wheels, "no.such": 1.0})
    assert refused == dict.fromkeys(wheels, "incomplete") | {
        "no.such": "unknown_signal"
    }
    assert gate.write("peer:a", wheels, broken=[TWIST[0], "pose.x_m"]) == {}


def test_a_part_of_a_command_is_no_offer_and_renews_nothing(world):
    gate, image, _, _clock = world
    gate.take("opcua")
    offer = dict.fromkeys(WHEELS, 5.0)
    refused = gate.write("peer:a", offer | {WHEELS[0]: math.nan})
    assert refused == dict.fromkeys(WHEELS, "incomplete") | {WHEELS[0]: "not_finite"}
    gate.take("peer")
    assert latched(image, WHEELS[1]) == 0.0
    gate.write("peer:a", offer)
    pushed = image.pushed_rows
    gate.write("peer:a", offer | {WHEELS[0]: math.nan, "drive.enable": True})
    assert image.pushed_rows == pushed + 1, "drive.enable alone, and no lease"


@given(
    st.floats(allow_nan=True, allow_infinity=True)
    | st.integers()
    | st.booleans()
    | st.text()
)
def test_only_finite_numbers_in_range_pass(value):
    signal = make_table()["wheel.fl.setpoint_rpm"]
    checked = check_value(signal, value)
    passes = (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) <= 90
    )
    assert isinstance(checked, tuple) == passes
    assert not passes or checked == (float(value),)


def test_a_client_whose_command_found_no_room_still_ends_that_of_another_one(world):
    gate, image, _, _ = world
    gate.take("opcua")
    gate.write("opcua", {"wheel.rl.setpoint_rpm": 20.0})
    assert latched(image, "wheel.rl.setpoint_rpm") == 20.0
    while not gate.write("opcua", {"lights.command": 1}):
        pass
    teleop = "opcua:teleop", {"wheel.fl.setpoint_rpm": 5.0}
    assert gate.write(*teleop) == {"wheel.fl.setpoint_rpm": Refusal.QUEUE_FULL}
    latch_inputs(image)
    assert gate.write(*teleop) == {}
    assert latched(image, "wheel.fl.setpoint_rpm") == 5.0
    assert latched(image, "wheel.rl.setpoint_rpm") == 0.0


def test_control_is_with_one_source_and_the_refusal_says_whose(world):
    gate, _, events, _ = world
    assert gate.write("opcua", {"twist.linear_m_s": 0.1}) == {
        "twist.linear_m_s": Refusal.NOT_IN_CONTROL
    }
    assert "'peer' has control" in events.recent[-1].message
    gate.request("opcua", "opcua")
    assert gate.write("opcua", {"twist.linear_m_s": 0.1}) == {}
    with pytest.raises(ControlRefused, match="outranks"):
        gate.request("peer", "peer")
    with pytest.raises(ControlRefused, match="sources are"):
        gate.request("scenario", "somebody")


def test_measured_values_need_no_control(world):
    gate, image, _, _ = world
    assert gate.write("opcua", {"measured.pose.x_m": 1.5}) == {}
    assert latched(image, "measured.pose.x_m") == 1.5


def test_a_full_queue_refuses_the_group_and_counts_it(world):
    gate, _, _, _ = world
    for _ in range(16):
        assert gate.write("peer:a", {"wheel.fl.setpoint_rpm": 1.0}) == {}
    refused = gate.write("peer:a", {"wheel.fl.setpoint_rpm": 2.0})
    assert refused == {"wheel.fl.setpoint_rpm": Refusal.QUEUE_FULL}


def test_age_counts_from_the_last_accepted_write(world):
    gate, _, _, clock = world
    assert gate.age_s("peer:a") is None
    gate.write("peer:a", {"wheel.fl.setpoint_rpm": 1.0})
    clock.pass_s(0.25)
    gate.write("peer:a", {"wheel.fl.setpoint_rpm": math.nan})
    assert gate.age_s("peer:a") == pytest.approx(0.25)


def test_a_change_is_measured_to_the_first_frame_that_contains_it(world):
    gate, image, _, clock = world
    received = clock()
    gate.write("peer:a", {"wheel.fl.setpoint_rpm": 5.0})
    assert gate.take_change(0) is None
    clock.pass_s(0.01)
    gate.write("peer:a", {"wheel.fl.setpoint_rpm": 5.0})  # no change
    assert gate.take_change(image.pushed_rows) == received
    assert gate.take_change(image.pushed_rows) is None


def test_the_end_of_the_leases_zeroes_every_setpoint(world):
    gate, image, _, _ = world
    gate.write(
        "peer:a",
        {"wheels.setpoints_rpm": [5.0, 5.0, -5.0, -5.0], "twist.linear_m_s": 0.1},
    )
    gate.end()
    assert latched(image, "wheel.rr.setpoint_rpm") == 0.0
    assert latched(image, "twist.linear_m_s") == 0.0


def test_a_silent_source_taints_only_what_it_wrote_last(world):
    gate, image, _, _ = world
    left, right = (make_table().slot(f"wheel.{w}.setpoint_rpm") for w in ("fl", "fr"))
    gate.write(
        "peer:a", {"wheel.fl.setpoint_rpm": 40.0, "wheel.fr.setpoint_rpm": -40.0}
    )
    gate.take("opcua")
    gate.write("opcua", {"wheel.fl.setpoint_rpm": 10.0})
    gate.mark_stale("peer:a")
    latch_inputs(image)
    assert (image.frame_values[left], image.frame_status[left]) == (10.0, GOOD)
    gate.take("peer")
    latch_inputs(image)
    assert (image.frame_values[right], image.frame_status[right]) == (
        -40.0,
        UNCERTAIN_LAST_USABLE_VALUE,
    )


def test_a_silent_source_brings_no_value_back(world):
    gate, image, _, _ = world
    gate.write("peer:a", {"wheel.fl.setpoint_rpm": 40.0})
    assert latched(image, "wheel.fl.setpoint_rpm") == 40.0
    gate.end()  # as Reset does
    gate.mark_stale("peer:a")
    assert latched(image, "wheel.fl.setpoint_rpm") == 0.0


def test_what_is_known_of_a_sample_does_not_depend_on_how_old_the_command_may_be(world):
    gate, image, _, clock = world
    clock.pass_s(10.0)
    received = clock()
    assert (
        gate.write("peer:a", {"wheel.fl.setpoint_rpm": 1.0}, commanded_ns=received - 5)
        == {}
    )
    assert gate.age_s("peer:a") == 0.0
    assert gate.take_change(image.pushed_rows) == received
    gate.write(
        "peer:a",
        {"wheel.fl.setpoint_rpm": 2.0},
        received_ns=received - 3,
        commanded_ns=0,
    )
    assert gate.take_change(image.pushed_rows) == received - 3


def test_a_group_is_sampled_where_one_of_its_values_is_new():
    table = robot_table(RANGES, samples=True)
    image = make_image(table, queue_rows=64)
    gate = make_gate(table, image, EventBus(), monotonic_ns=ManualClock())
    speed, place = "measured.wheel.fl.speed_rpm", "measured.nav.x_m"
    for news in (None, {speed}, {speed}, set()):
        assert gate.write("peer:robot", {speed: 1.0, place: 2.0}, news=news) == {}
    rows = {
        table.by_slot(row.slot).name: row.value
        for row in gate.stamps([place], 5.0, 0.03)
    }
    assert rows == {
        "internal.samples_nav": 2.0,
        "internal.time_nav_s": 5.0,
        "internal.taken_nav_s": 4.97,
    }
    (count,) = (
        r.value
        for r in gate.stamps([speed], 5.0)
        if "samples" in table.by_slot(r.slot).name
    )
    assert count == 4.0
    gate.leases.add("peer", 100.0, "zero")
    before = image.pushed_rows
    gate.write("peer:robot", {speed: 1.0})
    assert image.pushed_rows - before == 4, (
        "a value, its stamps, and nothing that renews"
    )
    image.close()
