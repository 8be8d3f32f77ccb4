"""The mechatronic model in the daemon's step: signals, walls, sensors, snapshots, a bad state."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hilserver.body.layout import BodyMotion, Signals
from hilserver.commands import main
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.daemon.outputs import PublishedOutputs
from hilserver.errors import ConfigError
from hilserver.image import Row
from hilserver.logs import read_log
from hilserver.logs.provenance import as_yaml
from hilserver.replay.origin import assembly_of
from hilserver.scheduler import faults
from hilserver.status import BAD_OUT_OF_SERVICE, GOOD

TORQUE = {"driven_by": "torque", "sensors": "body"}


def assembled(**section):
    config = Config.model_validate({"mechatronic": {"enabled": True, **section}})
    return assemble_config(config)


def value(core, name):
    return core.image.latest().values[core.table.slot(name)]


def status(core, name):
    return core.image.latest().status[core.table.slot(name)]


def drive(core, linear_m_s, angular_rad_s=0.0):
    twist = {"twist.linear_m_s": linear_m_s, "twist.angular_rad_s": angular_rad_s}
    assert core.gate.write("opcua", {"control.mode": 1, **twist}) == {}


def test_signals_lie_in_the_order_of_the_model():
    table = assembled().table
    first = table.slot("mech.x_m")
    begin = {
        "mech.roll_rad": "roll",
        "mech.linear_m_s": "linear",
        "mech.tof.fl_m": "tof",
        "mech.imu.gyro_x_rad_s": "gyro",
        "mech.imu.accel_x_m_s2": "accel",
        "mech.wheel.fl.speed_rpm": "speed",
        "mech.wheel.fl.normal_force_n": "normal",
        "mech.wheel.fl.slip_m_s": "slip",
        "mech.wheel.fl.torque_nm": "torque",
        "mech.gap_m": "gap",
        "mech.gap_yaw_rad": "gap_yaw",
        "mech.contact": "bump",
    }
    places = {name: Signals.where(field).start for name, field in begin.items()}
    assert {name: table.slot(name) - first for name in begin} == places
    assert "mech.x_m" not in assemble_config(Config()).table


async def test_the_body_follows_the_plant_until_a_wall_stops_it():
    async with build(assembled()) as core:
        drive(core, 0.5)
        await core.scheduler.advance(2001)
        assert value(core, "mech.gap_m") < 0.02
        assert value(core, "mech.contact") == 0.0
        assert value(core, "mech.imu.accel_z_m_s2") == pytest.approx(9.81, abs=0.01)
        forces = [
            value(core, f"mech.wheel.{w}.normal_force_n")
            for w in ("fl", "rl", "fr", "rr")
        ]
        assert sum(forces) == pytest.approx(5.0 * 9.81, rel=1e-3)
        for place in ("fl", "fr"):
            assert value(core, f"mech.tof.{place}_m") == pytest.approx(
                value(core, f"tof.{place}_m"), abs=0.02
            )
        await core.scheduler.advance(12_000)
        assert value(core, "mech.x_m") < 5.0 < value(core, "pose.x_m")
        assert value(core, "mech.linear_m_s") == pytest.approx(0.0, abs=1e-3)
        assert value(core, "mech.wheel.fl.slip_m_s") == pytest.approx(0.5, rel=0.01)
        assert value(core, "mech.tof.fl_m") < 0.06
        assert value(core, "mech.contact") == 1.0
        gap = value(core, "pose.x_m") - value(core, "mech.x_m")
        assert value(core, "mech.gap_m") == pytest.approx(gap, rel=0.01)
        outputs = PublishedOutputs(core)
        outputs.frame = core.image.latest()
        assert outputs.exported()["mech.gap_m"] == value(core, "mech.gap_m")


async def test_driven_by_torque_the_plant_sees_what_its_wheels_do():
    async with build(assembled(**TORQUE)) as core:
        drive(core, 0.5)
        await core.scheduler.advance(2001)
        asked = 0.5 / 0.085 * 60.0 / (2.0 * np.pi)
        assert value(core, "wheel.fl.speed_rpm") == pytest.approx(asked, rel=0.01)
        await core.scheduler.advance(12_000)
        assert value(core, "mech.linear_m_s") == pytest.approx(0.0, abs=1e-3)
        assert value(core, "tof.fl_m") == value(core, "mech.tof.fl_m")  # sensors: body
        assert value(core, "imu.gyro_z_rad_s") == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("driven_by", ["torque", "speed"])
async def test_at_a_wall_whatever_measures_the_robot_measures_its_body(driven_by):
    exact = dict.fromkeys(("white_noise_m", "correlated_noise_m", "yaw_noise_rad"), 0.0)
    body = {"enabled": True, "driven_by": driven_by, "sensors": "body"}
    config = {"mechatronic": body, "sensors": {"nav": {"enabled": True, **exact}}}
    async with build(assemble_config(Config.model_validate(config))) as core:
        # the wall is at 5 m
        place = {"internal.pose_request": 1.0, "internal.pose_x_m": 4.0}
        assert core.image.push(
            [Row(core.table.slot(name), v) for name, v in place.items()]
        )
        drive(core, 0.5)
        await core.scheduler.advance(4001)
        shown = {s.name: value(core, s.name) for s in core.table.scalars}
    assert shown["pose.x_m"] > 5.5 > 5.0 > shown["mech.x_m"], "pose.* stays planar"
    for axis in ("x_m", "y_m", "yaw_rad"):
        assert shown[f"nav.{axis}"] == pytest.approx(shown[f"mech.{axis}"], abs=1e-3)
    assert shown["imu.yaw_rad"] == pytest.approx(shown["mech.yaw_rad"], abs=1e-3)
    for corner in ("fl", "fr", "rl", "rr"):
        seen = shown[f"mech.tof.{corner}_m"]
        assert shown[f"tof.{corner}_m"] == pytest.approx(seen, abs=1e-3)
    for wheel in ("fl", "rl", "fr", "rr"):  # what odometry reads
        speed = shown[f"mech.wheel.{wheel}.speed_rpm"]
        assert shown[f"wheel.{wheel}.speed_rpm"] == pytest.approx(speed, abs=0.1)


async def test_a_snapshot_at_the_wall_goes_on_with_the_same_bits():
    async with build(assembled(**TORQUE)) as core:
        drive(core, 0.6)
        await core.scheduler.advance(7999)
        tick = await core.snapshots.capture()
        state = core.image.shadow.copy()
        await core.scheduler.advance(501)
        once = core.image.live.copy()
        await core.snapshots.restore(state, tick)
        await core.scheduler.advance(501)
        assert core.image.live.tobytes() == once.tobytes()


def test_a_recording_is_replayed_with_its_body(tmp_path):
    origin = assembled(**TORQUE)
    run = {"configuration": as_yaml(origin.config.model_dump(mode="json"))}
    run |= {"config_folder": str(tmp_path)}
    again = assembly_of(SimpleNamespace(path=tmp_path / "drive.mcap", run=run))
    assert again.config.mechatronic == origin.config.mechatronic


@pytest.mark.long
def test_a_replay_of_a_drive_into_the_wall_has_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    body = "mechatronic: {enabled: true, driven_by: torque, sensors: body}\n"
    Path("config.yaml").write_text(body + "sensors: {tof: {hall: hall.yaml}}\n")
    Path("hall.yaml").write_text("walls: [[0.4, -9, 0.4, 9]]\n")
    ahead = "{control.mode: 1, twist.linear_m_s: 0.6}"
    Path("ahead.yaml").write_text(f"steps: [{{at_s: 0.01, write: {ahead}}}]\n")
    assert main(["simulate", "ahead.yaml", "--duration", "1", "-o", "drive.mcap"]) == 0
    assert read_log(Path("drive.mcap")).columns["mech.x_m"][-1] < 0.2
    assert main(["replay", "drive.mcap", "-o", "again.csv", "--check"]) == 0


async def test_set_pose_takes_the_body_along():
    async with build(assembled()) as core:
        drive(core, 0.3)
        await core.scheduler.advance(500)
        pose = {
            "internal.pose_request": 1.0,
            "internal.pose_x_m": 1.0,
            "internal.pose_yaw_rad": 1.0,
        }
        assert core.image.push(
            [Row(core.table.slot(name), v) for name, v in pose.items()]
        )
        await core.scheduler.advance(3)
        assert value(core, "mech.x_m") == pytest.approx(1.0, abs=0.01)
        assert value(core, "mech.yaw_rad") == pytest.approx(1.0, abs=0.01)


async def test_a_bad_state_is_the_safe_state_and_says_so():
    async with build(assembled()) as core:
        await core.scheduler.advance(10)
        values, _ = core.image.region("body")
        BodyMotion.of(values).velocity[0] = np.nan
        await core.scheduler.advance(10)
        assert core.image.control.first_fault == faults.SLICE + faults.BODY
        assert "mechatronic" in faults.fault_of(core.image.control.first_fault).text
        assert status(core, "mech.x_m") == BAD_OUT_OF_SERVICE
        assert np.all(np.isfinite(core.image.latest().values))
        assert status(core, "sim.tick") == GOOD


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"driven_by": "torque"}, "needs sensors: body"),
        ({"step_ms": 3.0}, "multiple of step_ms"),
        ({"slice": "fast"}, "there is no plant-side slice 'fast'"),
    ],
)
def test_what_cannot_run_is_refused(section, words):
    with pytest.raises((ConfigError, ValueError), match=words):
        assembled(**section)
