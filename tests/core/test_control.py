"""The state machine: states, safe state, acknowledgement."""

import asyncio

import pytest

from hilserver.core.control import Control
from hilserver.core.events import EventBus, EventKind
from hilserver.core.snapshot import SnapshotStore
from hilserver.core.transitions import TRANSITIONS, Command
from hilserver.errors import ControlRefused
from hilserver.image import Row, press_stop
from hilserver.kernel.phases import enter_safe, latch, requested
from hilserver.kernel.places import Places
from hilserver.plant.layout import State as PlantState
from hilserver.signals import State
from tests.fakes import make_gate, make_image, make_table


class Pacing:
    """Counts commands and ticks; the real scheduler has tests of its own."""

    def __init__(self):
        self.tick = 0
        self.log = []

    def pause(self):
        self.log.append("pause")

    def resume(self):
        self.log.append("resume")

    def step(self, n):
        self.log.append(f"step {n}")

    def set_speed(self, factor):
        self.log.append(f"speed {factor}")


class World:
    def __init__(self, tmp_path, *, waits_for_start=True):
        self.table = make_table()
        self.image = make_image(self.table, live={"x": PlantState.n_words})
        self.events = EventBus()
        self.pacing = Pacing()
        options = {
            "ramp_ticks": 5,
            "owner": "opcua",
            "waits_for_start": waits_for_start,
        }
        self.gate = make_gate(self.table, self.image, self.events, **options)
        snapshots = SnapshotStore(
            self.image, tmp_path / "snapshots", {"parameters": "abc"}
        )
        self.control = Control(
            self.table,
            self.image,
            self.gate,
            self.events,
            self.pacing,
            snapshots,
        )
        self.control.started()

    @property
    def at(self):
        names = ("internal.command", "drive.enable", "internal.state", "sim.tick")
        return Places(*[0] * 8, *map(self.table.slot, names))

    def latch(self):
        self.pacing.tick = latch(
            requested(self.image.words),
            self.pacing.tick,
            self.pacing.tick * 1_000_000,
            self.at,
            self.image.values,
            self.image.words,
        )

    def value(self, name):
        return self.image.frame_values[self.table.slot(name)]


@pytest.fixture
def world(tmp_path):
    world = World(tmp_path)
    yield world
    world.image.close()


def test_run_pause_step_run(world):
    control = world.control
    assert control.state is State.RUNNING
    with pytest.raises(ControlRefused, match="only in state paused"):
        control.step(3)
    control.pause()
    control.step(3)
    assert control.state is State.PAUSED
    assert world.image.control.state == 2
    control.start()
    assert world.pacing.log == ["pause", "step 3", "resume"]


BY_METHOD = {
    Command.START: lambda control: control.start(),
    Command.PAUSE: lambda control: control.pause(),
    Command.STEP: lambda control: control.step(1),
    Command.STOP: lambda control: control.stop(),
    Command.RESET: lambda control: control.reset(),
    Command.STARTED: lambda control: control.started(),
    Command.FAULT: lambda control: control.enter_safe("a fault", cause=None),
    Command.END: lambda control: control.stopping("the end"),
}


@pytest.mark.parametrize("command", BY_METHOD, ids=str)
@pytest.mark.parametrize("state", State, ids=lambda state: state.word)
def test_a_command_leads_where_the_table_says(tmp_path, state, command):
    world = World(tmp_path)
    world.control.state = state
    following = TRANSITIONS[command][state]
    try:
        if following is None:
            with pytest.raises(
                ControlRefused, match=f"{command} is not possible in state"
            ):
                BY_METHOD[command](world.control)
        else:
            BY_METHOD[command](world.control)
        assert world.control.state is (state if following is None else following)
    finally:
        world.image.close()


def test_safe_state_disables_the_drive_after_the_ramp_and_waits_for_reset(world):
    control = world.control
    world.gate.write("opcua", {"wheel.fl.setpoint_rpm": 50.0})
    control.enter_safe("peer 'a' is silent", cause="peer:a")
    world.latch()
    assert control.state is State.SAFE
    assert world.value("internal.command") == 2.0
    control.supervise()
    world.latch()
    assert world.value("drive.enable") == 1.0, "still ramping"
    for _ in range(5):
        world.latch()
    assert world.value("drive.enable") == 0.0
    assert world.events.recent[-1].kind is EventKind.SAFE_STATE
    assert world.events.recent[-1].message.endswith("call Reset once this has cleared")
    with pytest.raises(ControlRefused, match="peer 'a' is silent"):
        control.reset()
    for forbidden in (control.start, control.pause):
        with pytest.raises(ControlRefused, match="safe"):
            forbidden()
    control.clear_cause("peer:a")
    assert world.events.recent[-1].message.endswith("call Reset to resume")
    control.reset()
    world.latch()
    assert control.state is State.RUNNING
    assert world.value("internal.command") == 0.0
    assert world.value("drive.enable") == 1.0
    assert world.value("wheel.fl.setpoint_rpm") == 0.0, (
        "an old set-point must not come back"
    )


HELD = {"wheel.fl.setpoint_rpm": 50.0}


def test_after_a_stop_a_controller_drives_by_start_and_not_by_reset(world):
    control = world.control
    assert world.gate.write("opcua", HELD) == {}, "the first start is as before"
    control.stop()
    control.reset()
    assert world.gate.write("opcua", HELD) == {"wheel.fl.setpoint_rpm": "not_started"}
    world.latch()
    assert (control.state, world.value("wheel.fl.setpoint_rpm")) == (State.RUNNING, 0.0)
    assert world.value("control.waits_for_start") == 1.0
    assert "wait for Start" in control.reason
    assert "wait for Start" in world.events.recent[-1].message
    control.start()
    assert (control.state, control.reason) == (State.RUNNING, "running")
    assert world.gate.write("opcua", HELD) == {}
    world.latch()
    assert world.value("wheel.fl.setpoint_rpm") == 50.0
    assert world.value("control.waits_for_start") == 0.0


def test_a_controller_drives_on_after_a_reset_where_it_may(tmp_path):
    world = World(tmp_path, waits_for_start=False)
    world.control.stop()
    world.control.reset()
    assert world.gate.write("opcua", HELD) == {}
    assert "without Start" in world.events.recent[-1].message
    world.image.close()


def test_nothing_but_start_ends_the_wait(world):
    control = world.control
    control.stop()
    control.reset()
    world.latch()
    control.reset()  # of the simulation, which puts every signal back
    world.latch()
    control.supervise()
    world.latch()
    assert world.value("control.waits_for_start") == 1.0
    control.pause()
    assert world.gate.write("opcua", HELD) == {"wheel.fl.setpoint_rpm": "not_started"}


async def test_a_snapshot_of_before_ends_no_wait_and_one_of_a_wait_brings_it_back(
    world,
):
    task = asyncio.create_task(latching(world))
    control = world.control
    await control.save_snapshot("before")
    control.stop()
    control.reset()
    world.latch()
    await control.save_snapshot("waiting")
    await control.load_snapshot("before")
    assert world.gate.interlock.waits
    control.start()
    await control.load_snapshot("waiting")
    assert world.gate.write("opcua", HELD) == {"wheel.fl.setpoint_rpm": "not_started"}
    assert "wait for Start" in control.reason
    task.cancel()


async def test_a_reset_does_not_get_into_a_snapshot_being_saved(world):
    world.image.frame_values[20] = 7.0
    saving = asyncio.create_task(world.control.save_snapshot("now"))
    await asyncio.sleep(0.01)
    with pytest.raises(ControlRefused, match="is not possible yet"):
        world.control.reset()
    world.latch()
    await saving
    world.image.frame_values[20] = 0.0
    loading = asyncio.create_task(world.control.load_snapshot("now"))
    while not loading.done():
        world.latch()
        await asyncio.sleep(0.005)
    await loading
    assert world.image.frame_values[20] == 7.0


def test_in_the_safe_state_nobody_enables_the_drive(world):
    control = world.control
    control.stop()
    for _ in range(6):
        world.latch()
    assert world.gate.write("opcua", {"drive.enable": True}) == {}
    world.latch()
    assert world.value("drive.enable") == 0.0
    control.reset()
    world.latch()
    assert world.value("drive.enable") == 1.0


@pytest.mark.parametrize("when", ["before Stop", "after Stop"])
def test_reset_enables_no_drive_that_its_host_has_disabled(world, when):
    control, disable = world.control, {"drive.enable": False}
    for said in ("before Stop", "after Stop"):
        if when == said:
            assert world.gate.write("opcua", disable) == {}
        world.latch()
        control.stop()
    for _ in range(6):
        world.latch()
    control.reset()
    for _ in range(3):
        world.latch()
        assert world.value("drive.enable") == 0.0
    control.start()
    world.latch()
    assert world.value("drive.enable") == 0.0


def test_the_safe_state_reaches_the_plant_although_the_queue_was_full(world):
    rows = [Row(world.table.slot("lights.red"), 1.0)]
    while world.image.push(rows):
        pass
    world.control.stop()
    world.latch()
    assert world.value("internal.command") == 2.0


def test_the_plant_obeys_stop_before_the_daemon_knows_of_it(world):
    press_stop(world.image.name)
    world.latch()
    assert (world.control.state, world.value("internal.command")) == (
        State.RUNNING,
        2.0,
    )
    world.control.supervise()
    assert (world.control.state, world.control.reason) == (
        State.SAFE,
        "stopped by command",
    )
    world.control.reset()
    world.latch()
    assert (world.control.state, world.value("internal.command")) == (
        State.RUNNING,
        0.0,
    )


def test_reset_acknowledges_no_stop_that_was_pressed_since(world):
    world.control.stop()
    press_stop(world.image.name)
    world.control.reset()
    world.latch()
    assert world.value("internal.command") == 2.0
    world.control.supervise()
    assert world.control.state is State.SAFE


def test_a_stop_followed_at_once_by_reset_is_acknowledged(world):
    world.control.stop()
    world.control.reset()
    world.latch()
    assert (world.control.state, world.value("internal.command")) == (
        State.RUNNING,
        0.0,
    )


def test_a_fault_of_the_paced_loop_is_taken_over(world):
    enter_safe(2, world.at, world.image.values, world.image.words)
    assert world.value("internal.command") == 2.0
    world.control.supervise()
    assert world.control.state is State.SAFE
    assert "consecutive overruns" in world.control.reason
    world.control.reset()
    assert world.image.control.first_fault == 0


def test_reset_outside_the_safe_state_starts_the_simulation_anew(world):
    world.image.frame_values[20] = 7.0
    world.pacing.tick = 1234
    world.control.reset()
    world.latch()
    assert world.image.frame_values[20] == 0.0
    assert world.pacing.tick == 0


def test_pose_requests_are_numbered_even_after_a_restore(world):
    world.control.set_pose(1.0, 2.0, 0.5)
    world.latch()
    assert world.value("internal.pose_request") == 1.0
    world.image.frame_values[world.table.slot("internal.pose_request")] = 9.0
    world.control.set_pose(1.0, 2.0, 0.5)
    world.latch()
    assert world.value("internal.pose_request") == 10.0
    with pytest.raises(ValueError, match="pose_yaw_rad"):
        world.control.set_pose(0.0, 0.0, float("nan"))


async def latching(world):
    while True:
        world.latch()
        await asyncio.sleep(0)


async def test_snapshot_holds_values_and_tick_and_comes_back(world):
    task = asyncio.create_task(latching(world))
    world.image.frame_values[20], world.pacing.tick = 3.5, 77
    await world.control.save_snapshot("first")
    world.image.frame_values[20], world.pacing.tick = 9.0, 99
    await world.control.load_snapshot("first")
    task.cancel()
    assert (world.image.frame_values[20], world.pacing.tick) == (3.5, 77)


def test_what_waits_to_be_latched_does_not_survive_a_reset(world):
    """Before, a command of the same millisecond drove for another lease."""
    world.gate.take("page")
    world.latch()
    assert (
        world.gate.write("page:1", {"control.mode": 1, "twist.linear_m_s": 0.4}) == {}
    )
    world.control.reset()
    for _ in range(10):
        world.latch()
        assert world.value("twist.linear_m_s") == 0.0


async def test_a_hand_that_drives_while_a_snapshot_is_loaded_has_to_let_go(world):
    """Before, a command that came between the plant's jump and our notice of it still acted."""
    task = asyncio.create_task(latching(world))
    await world.control.save_snapshot("first")
    task.cancel()
    world.gate.take("page")
    held = {"control.mode": 1, "twist.linear_m_s": 0.4}
    assert world.gate.write("page:1", held) == {}
    before = world.image.control.request
    loading = asyncio.create_task(world.control.load_snapshot("first"))
    while world.image.control.request == before:  # noqa: ASYNC110 - a word of shared memory
        await asyncio.sleep(0)
    world.latch()
    assert world.gate.write("page:1", held) == dict.fromkeys(held, "not_at_rest")
    await loading
    world.latch()
    assert world.value("twist.linear_m_s") == 0.0


async def test_a_controller_is_not_called_silent_after_a_snapshot_in_which_it_waits(
    world,
):
    """Before, what it said while that was loaded left a lease that nobody could renew."""
    control, gate = world.control, world.gate
    gate.leases.add("peer:a", 500.0, "ramp")
    gate.take("peer")
    task = asyncio.create_task(latching(world))
    control.stop()
    control.reset()
    world.latch()
    await control.save_snapshot("waiting")
    task.cancel()
    control.start()
    before = world.image.control.request
    loading = asyncio.create_task(control.load_snapshot("waiting"))
    while world.image.control.request == before:  # noqa: ASYNC110 - a word of shared memory
        await asyncio.sleep(0)
    world.latch()
    gate.write("peer:a", HELD)
    world.latch()
    await loading
    for _ in range(600):
        gate.write("peer:a", HELD)
        world.pacing.tick += 1
        world.latch()
    assert not gate.leases.has_lapsed("peer:a")


@pytest.mark.parametrize(
    "name", ["../x", "/etc/passwd", "", "a/b", ".hidden", "x" * 200]
)
async def test_snapshot_names_are_no_paths(world, name):
    with pytest.raises(ControlRefused, match="plain file name"):
        await world.control.save_snapshot(name)


async def test_snapshots_that_do_not_fit_are_refused(world, tmp_path):
    task = asyncio.create_task(latching(world))
    await world.control.save_snapshot("good")
    other = SnapshotStore(world.image, tmp_path / "snapshots", {"parameters": "def"})
    with pytest.raises(ControlRefused, match="parameters"):
        await other.load("good")
    (tmp_path / "snapshots" / "bad.npz").write_bytes(b"PK\x03\x04 half a file")
    with pytest.raises(ControlRefused, match="damaged"):
        await world.control.load_snapshot("bad")
    with pytest.raises(ControlRefused, match="there is no snapshot"):
        await world.control.load_snapshot("absent")
    task.cancel()


async def test_a_plant_that_does_not_answer_is_named(world, monkeypatch):
    monkeypatch.setattr("hilserver.core.snapshot._SERVED_WITHIN_S", 0.01)
    with pytest.raises(ControlRefused, match="did not answer"):
        await world.control.save_snapshot("never")


def test_a_pose_is_not_aligned_with_one_that_nobody_measures(world):
    with pytest.raises(ControlRefused, match="AlignPose needs"):
        world.control.align_pose()
