"""Who may write at the gate: by what a door grants, and of two that write one signal the first."""

import pytest

from hilserver.config.doors import WRITING, DoorRule
from hilserver.core.events import EventBus
from tests.fakes import ManualClock, latch_inputs, make_gate, make_image, make_table

SPEED, MEASURED = "wheel.fl.setpoint_rpm", "measured.wheel.fl.speed_rpm"
VIEWER = DoorRule("Foxglove", "page:foxglove", "foxglove.grants", True, WRITING, None)


class World:
    def __init__(self, **options):
        self.table, self.clock, self.events = make_table(), ManualClock(), EventBus()
        self.image = make_image(self.table)
        self.gate = make_gate(
            self.table, self.image, self.events, monotonic_ns=self.clock, **options
        )

    def latched(self, name):
        latch_inputs(self.image)
        return self.image.frame_values[self.table.slot(name)]


@pytest.fixture
def world(request):
    made = []

    def make(**options):
        made.append(World(**options))
        return made[-1]

    yield make
    for one in made:
        one.image.close()


def test_a_door_without_rights_only_watches(world):
    w = world(owner="page", doors=[VIEWER._replace(stranger=None)])
    refused = w.gate.write("page:foxglove", {SPEED: 30.0, MEASURED: 12.5})
    assert refused == dict.fromkeys((SPEED, MEASURED), "not_granted")
    assert w.latched(SPEED) == 0.0
    first, second = (event.message for event in w.events.recent)
    assert (
        "Foxglove knows no log-in, and foxglove.grants does not name 'command'" in first
    )
    assert "'measured'" in second
    w.gate.write("page:foxglove", {SPEED: 40.0})
    assert len(w.events.recent) == 2
    assert w.gate.rejected["page", "not_granted"] == 3


def test_what_is_granted_is_accepted(world):
    w = world(
        owner="page", doors=[VIEWER._replace(stranger=None, grants=("measured",))]
    )
    assert w.gate.write("page:foxglove", {SPEED: 30.0, MEASURED: 12.5}) == {
        SPEED: "not_granted"
    }
    assert w.latched(MEASURED) == 12.5


def test_a_door_without_a_log_in_yields_to_the_person_who_drives(world):
    w = world(owner="opcua", doors=[VIEWER])
    w.gate.request("page", "page", object())
    assert w.gate.write("page:1", {SPEED: 20.0}) == {}
    assert w.gate.write("page:foxglove", {SPEED: -60.0}) == {SPEED: "not_in_control"}
    assert w.latched(SPEED) == 20.0
    assert "a person drives by 'page'" in w.events.recent[-1].message
    assert w.gate.write("page:1", {SPEED: 0.0}) == {}
    assert w.gate.write("page:foxglove", {SPEED: 10.0}) == {}


@pytest.mark.parametrize("name", [SPEED, MEASURED])
def test_of_two_peers_the_first_keeps_a_signal_until_it_is_silent(world, name):
    w = world(owner="peer")
    assert w.gate.write("peer:a", {name: 10.0}) == {}
    w.clock.pass_s(60.0)  # its link judges its silence
    assert w.gate.write("peer:s7", {name: -10.0, "drive.enable": True}) == {
        name: "not_in_control"
    }
    assert w.latched(name) == 10.0
    assert (
        f"peer:s7: {name} = -10.0 refused: 'peer:a' writes it"
        in w.events.recent[-1].message
    )
    told = len(w.events.recent)
    w.gate.write("peer:s7", {name: -10.0})
    assert len(w.events.recent) == told
    w.gate.mark_stale("peer:a")
    assert w.gate.write("peer:s7", {name: -10.0}) == {}
    assert w.gate.write("peer:a", {name: 10.0}) == {name: "not_in_control"}


def test_peers_may_share_the_wheels(world):
    w = world(owner="peer")
    assert w.gate.write("peer:a", {SPEED: 10.0}) == {}
    assert w.gate.write("peer:b", {"wheel.fr.setpoint_rpm": 20.0}) == {}
    assert w.latched(SPEED) == 10.0


def test_a_client_keeps_a_measured_value_for_a_second(world):
    w = world(owner="peer")
    assert w.gate.write("opcua", {MEASURED: 1.0}) == {}
    assert w.gate.write("peer:a", {MEASURED: 2.0}) == {MEASURED: "not_in_control"}
    w.clock.pass_s(1.1)
    assert w.gate.write("peer:a", {MEASURED: 2.0}) == {}


def test_only_a_door_without_a_log_in_can_lack_a_grant(world):
    closed = VIEWER._replace(source="peer:s7", is_open=False)
    w = world(doors=[VIEWER, closed], named=("page", "peer:s7"))
    assert ("page", "not_granted") in w.gate.rejected
    assert ("peer:s7", "not_granted") not in w.gate.rejected
