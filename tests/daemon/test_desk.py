"""Scenarios and recordings by name: one at a time, and what has ended by itself is over."""

import asyncio
import contextlib

import pytest
import yaml

from hilserver.config.recording import RecordingConfig
from hilserver.config.root import Config
from hilserver.core.control import Control
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.daemon.desk import Recordings, Scenarios
from hilserver.errors import ControlRefused
from hilserver.faults import Scenario, load_scenario
from hilserver.image import Row
from hilserver.testing.opening import open_hil

CONFIG = Config.model_validate({"scheduler": {"backend": "virtual"}})
DRIVES = {
    "ahead.yaml": ("twist.linear_m_s", 0.1),
    "turn.yaml": ("twist.angular_rad_s", 0.2),
}


@pytest.fixture
async def run(tmp_path):
    for name, (signal, value) in DRIVES.items():
        begin = {"at_s": 0, "write": {"control.mode": 1, signal: value}}
        steps = [begin, {"at_s": 9, "write": {signal: 0.0}}]
        (tmp_path / name).write_text(yaml.safe_dump({"steps": steps}), encoding="utf-8")
    late = [
        {"at_s": s, "write": {"control.mode": 1, "twist.linear_m_s": 0.3}}
        for s in (0, 0.5)
    ]
    (tmp_path / "late.yaml").write_text(
        yaml.safe_dump({"steps": late}), encoding="utf-8"
    )
    async with build(assemble_config(CONFIG, tmp_path)) as core:
        core.image.control.state = 1
        yield core, Scenarios(tmp_path, core.stage(), core)


async def test_of_scenarios_started_at_once_one_plays(run):
    core, scenarios = run
    names = ("ahead.yaml", "turn")  # with and without the suffix
    answers = await asyncio.gather(*map(scenarios.start, names), return_exceptions=True)
    (refused,) = (answer for answer in answers if answer is not None)
    assert isinstance(refused, ControlRefused)
    assert "call StopScenario first" in str(refused)
    await core.scheduler.advance(100)
    values = core.image.latest().values
    driven = {n for n, (signal, _) in DRIVES.items() if values[core.table.slot(signal)]}
    assert driven == {scenarios.view()["name"]}


async def test_after_a_stop_no_planned_step_drives(run):
    core, scenarios = run
    control = Control(
        core.table, core.image, core.gate, core.events, core.scheduler, core.snapshots
    )
    control.on_acknowledge = scenarios.cut_short
    control.started()
    speed = lambda: core.image.latest().values[core.table.slot("twist.linear_m_s")]  # noqa: E731
    await scenarios.start("late")
    await core.scheduler.advance(100)
    assert speed() > 0
    control.stop()
    await core.scheduler.advance(100)
    control.reset()
    await core.scheduler.advance(1000)
    assert (speed(), core.gate.owner, scenarios.view()) == (0.0, "nobody", None)
    await scenarios.start("late")
    await core.scheduler.advance(1000)
    assert speed() == 0.3


@pytest.mark.parametrize("is_safe", [False, True])
@pytest.mark.usefixtures("run")
async def test_a_reset_that_the_plant_has_no_room_for_changes_nothing(
    tmp_path, is_safe
):
    async with open_hil(None, "virtual", scenario=tmp_path / "late.yaml") as hil:
        control, faults = hil.daemon.control, hil.daemon.faults
        await hil.run_for(0.1)
        if is_safe:
            control.stop()
        hil.inject({"fault": "bias", "signal": "pose.x_m", "offset": 1.0})
        await hil.step()
        before, owner = control.state, hil.daemon.gate.owner
        with contextlib.suppress(ValueError):
            for _ in range(1000):
                faults.force("pose.y_m", 1.0)
        with pytest.raises(
            ControlRefused, match="has not applied the last faults yet; try again"
        ):
            control.reset()
        assert (control.state, hil.daemon.gate.owner) == (before, owner)
        await hil.step()
        assert hil.tick > 100, "it has begun anew"
        assert "bias:pose.x_m" in faults.names
        control.reset()
        await hil.step()
        assert (control.state.word, hil.tick > 100) == ("running", is_safe)


FAULTS = [
    {"fault": "noise", "signal": "pose.x_m", "sd": 0.1, "name": f"n{i}"}
    for i in range(20)
]


async def test_a_reset_without_room_for_the_scenario_s_faults_changes_nothing(
    run, tmp_path
):
    step = {"at_s": 0.05, "write": {"twist.linear_m_s": 0.1}}
    path = tmp_path / "faulty.yaml"
    path.write_text(yaml.safe_dump({"steps": [step], "faults": FAULTS}))
    async with open_hil(None, "virtual", scenario=path) as hil:
        control, faults = hil.daemon.control, hil.daemon.faults
        await hil.run_for(0.1)
        for _ in range(58):  # each ends the one before: 115 commands of 128
            faults.force("pose.y_m", 1.0)
        before = (faults.names, hil.daemon.gate.owner)
        with pytest.raises(
            ControlRefused, match="has not applied the last faults yet; try again"
        ):
            control.reset()
        assert (faults.names, hil.daemon.gate.owner) == before
        await hil.step()
        assert hil.tick > 100, "it has begun anew"
        control.reset()
        await hil.step()
        assert (hil.tick, faults.names.count("n1;"), faults.forced) == (1, 1, "")


async def test_a_reset_without_room_for_the_scenario_s_steps_changes_nothing(
    run, tmp_path
):
    names = [f"wheel.{w}.setpoint_rpm" for w in ("fl", "rl", "fr", "rr")]
    steps = [
        {"at_s": 0.001 * i, "write": dict.fromkeys(names, 1.0)} for i in range(1, 1800)
    ]
    path = tmp_path / "long.yaml"
    path.write_text(yaml.safe_dump({"steps": steps}))
    async with open_hil(None, "virtual", scenario=path) as hil:
        await hil.run_for(0.1)
        short = load_scenario(tmp_path / "late.yaml")
        hil.daemon.stage.play(short, hil.daemon.scheduler.tick + 1)
        with pytest.raises(
            ControlRefused, match="call Stop and Reset to end them, then try again"
        ):
            hil.daemon.control.reset()
        await hil.step()
        assert hil.tick > 100
        for command in (hil.daemon.control.stop, hil.daemon.control.reset):
            command()
            await hil.run_for(0.1)
        hil.daemon.control.reset()
        await hil.step()
        assert hil.tick == 1


def fill_inputs(core):
    row = Row(core.table.slot("lights.red"), 0.0)
    while core.image.push([row]):
        pass


async def test_a_reset_that_cannot_give_control_to_the_scenario_changes_nothing(
    run, tmp_path
):
    step = {"at_s": 0.05, "write": {"twist.linear_m_s": 0.1}}
    path = tmp_path / "faulty.yaml"
    path.write_text(yaml.safe_dump({"steps": [step], "faults": FAULTS}))
    async with open_hil(None, "virtual", scenario=path) as hil:
        control, faults, gate = hil.daemon.control, hil.daemon.faults, hil.daemon.gate
        await hil.run_for(0.1)
        gate.take("opcua")
        faults.clear("n1")
        fill_inputs(hil.daemon.core)
        before = (faults.names, gate.owner)
        with pytest.raises(ControlRefused, match="the input queue is full: try again"):
            control.reset()
        assert (faults.names, gate.owner) == before
        await hil.step()
        assert hil.tick > 100, "it has begun anew"
        control.reset()
        await hil.step()
        assert (hil.tick, gate.owner, faults.names.count("n1;")) == (1, "scenario", 1)


def outrank(core):
    core.gate.priority = ("page", "opcua")


def fill_mail(core):
    for _ in range(58):  # each ends the one before: 115 commands of 128
        core.faults.force("pose.y_m", 1.0)


@pytest.mark.parametrize(
    ("hinder", "why"),
    [
        (outrank, "'scenario' cannot take control; sources are page, opcua"),
        (fill_inputs, "the input queue is full: try again"),
        (fill_mail, "20 commands are too many at once; try again"),
    ],
)
async def test_a_scenario_that_cannot_begin_changes_nothing(run, hinder, why):
    core, _ = run
    step = {"at_s": 0.05, "write": {"twist.linear_m_s": 0.1}}
    scenario = Scenario.model_validate({"steps": [step], "faults": FAULTS})
    hinder(core)
    owner = core.gate.owner
    with pytest.raises(ControlRefused) as refused:
        # at once: while it waits, the plant takes what is queued
        core.stage().play(scenario)
    assert str(refused.value) == why
    assert (core.faults.names, core.gate.owner) == ("", owner)


async def test_a_scenario_without_room_for_its_faults_changes_nothing(run, tmp_path):
    core, scenarios = run
    step = {"at_s": 0.05, "write": {"twist.linear_m_s": 0.1}}
    (tmp_path / "faulty.yaml").write_text(
        yaml.safe_dump({"steps": [step], "faults": FAULTS})
    )
    core.faults.inject(*({**fault, "name": f"m{i}"} for i, fault in enumerate(FAULTS)))
    owner = core.gate.owner
    with pytest.raises(
        ControlRefused, match=r"more than 32 signals .* clear the other faults"
    ):
        await scenarios.start("faulty")
    await core.scheduler.advance(100)
    speed = core.image.latest().values[core.table.slot("twist.linear_m_s")]
    assert (speed, core.gate.owner, scenarios.view()) == (0.0, owner, None)


async def test_a_recording_that_has_ended_by_itself_is_over(run, tmp_path):
    core, _ = run
    told = []
    core.tasks.tell = told.append
    recordings = Recordings(
        tmp_path, RecordingConfig(keep_free_mb=1e9), core.image.name, core.tasks
    )
    try:
        for name in ("hall.parquet", "drive.xyz", "run.h5"):
            with pytest.raises(ControlRefused, match=rf"'{name}' does not end in"):
                recordings.start(name)
        for asked, name in (("first.csv", "first.csv"), ("hall.v2", "hall.v2.mcap")):
            recordings.start(asked)
            assert recordings.view()["name"] == name
            async with asyncio.timeout(120):
                while recordings.view() is not None:  # noqa: ASYNC110 - a child ends it
                    await asyncio.sleep(0.05)
            # it could not begin: the disk is too full
            assert not (tmp_path / name).exists()
            ended = told.pop()
            assert ended.name == "recording"
            assert str(ended.error).startswith(f"{name}: ")
            assert "MB are left on the disk; remove some files" in str(ended.error)
        assert core.tasks.failures["recording"] == 2
        assert not told
        with pytest.raises(ControlRefused, match="nothing is being recorded"):
            recordings.stop()
    finally:
        await recordings.close()
