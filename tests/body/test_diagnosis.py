"""The body's drive as measured data: a diagnosis names its tyres, and says when it was blocked."""

import asyncio
import math

import numpy as np
import pytest

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.diagnosis.checks import blocked
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.schema.findings import Verdict
from hilserver.faults.scenario import Play, Scenario
from hilserver.measured.channels import DUTIES, GYRO, SETPOINTS, SPEEDS, TAG
from hilserver.measured.frames import Sampling
from hilserver.measured.reading import read_measured
from hilserver.plant.hall import wall_solids
from hilserver.plant.parameters import RobotParameters
from hilserver.replay.simulation import Simulation
from tests.body.rig import MIRROR, Body
from tests.diagnosis.checks.samples import log_of
from tests.diagnosis.own_recordings.recordings import DRIVES, wheels

RECORDED = ("sim.tick", *SETPOINTS, *SPEEDS, *DUTIES, GYRO)
POSE = ("mech.x_m", "mech.y_m", "mech.yaw_rad")
ROW, SAMPLE = 20, 100
"""Ticks between two rows, and between two of the tag."""
NOISE = {**dict.fromkeys(SPEEDS, 0.1), **dict.fromkeys(DUTIES, 0.1), GYRO: 0.006}
TAG_NOISE = (0.01, 0.01, 0.01)
MODEL = Config()
GRID_S = 1e-3 * ROW


def on_rows(steps):
    """The steps at the times of rows: a table shows set-points no better."""
    return Scenario.model_validate(
        {
            "steps": [
                {**step, "at_s": round(step["at_s"] / GRID_S) * GRID_S}
                for step in steps
            ]
        }
    )


async def driven(config, scenario, seconds):
    """Signals of the body at every tick."""
    async with Simulation(assemble_config(config), Play(scenario)) as simulation:
        slots = [simulation.table.slot(name) for name in (*RECORDED, *POSE)]
        batches = simulation.frames(round(1e3 * seconds))
        return np.concatenate(
            [batch.frames.values[:, slots] async for batch in batches]
        )


def omni(seconds, seed):
    """Mecanum wheels that drive ahead, to the side and turn, all at once."""
    rng, at_s, steps = np.random.default_rng(seed), 0.0, []
    while at_s < seconds:
        ahead, aside, turn = rng.uniform(-1.0, 1.0, 3) * (40.0, 25.0, 20.0)
        left = (ahead - aside - turn, ahead + aside - turn)
        right = (ahead + aside + turn, ahead - aside + turn)
        speeds = MIRROR * (*left, *right)
        steps.append({"at_s": at_s, "write": {"wheels.setpoints_rpm": speeds.tolist()}})
        at_s += rng.uniform(0.4, 2.0)
    return steps


def found_in(folder, config, scenario, seconds, model=MODEL, **other):
    """The findings of a drive, with the body's pose in place of a tag's, and with noise."""
    rng, path = np.random.default_rng(1), folder / "drive.csv"
    frames = asyncio.run(driven(config, scenario, seconds))[::ROW]
    for name, size in (NOISE | other).items():
        frames[:, RECORDED.index(name)] += size * rng.standard_normal(len(frames))
    tag = frames[:, -3:] + rng.normal(size=(len(frames), 3)) * TAG_NOISE
    tag[:, 2] = np.remainder(tag[:, 2] + math.pi, 2.0 * math.pi) - math.pi
    tag[np.arange(len(tag)) % (SAMPLE // ROW) != 0] = np.nan
    rows = np.column_stack([GRID_S * np.arange(len(frames)), frames[:, :-3], tag])
    lines = [",".join("" if v != v else repr(v) for v in row) for row in rows.tolist()]
    head = ",".join(("t_s", *RECORDED, *TAG))
    path.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")
    log = read_measured([path], None, Sampling.of(model))
    return diagnose(log, assemble_config(model), jobs=1).findings


@pytest.mark.long
def test_tyres_that_grip_across_are_a_rotation_gain(tmp_path):
    tyre = {"mu_long": 0.6, "mu_lat": 0.6 * 2.24}
    body = {"enabled": True, "tyre": tyre, "centre_of_mass_m": (0.05, 0.0, 0.06)}
    config = Config.model_validate({"mechatronic": body | {"sensors": "body"}})
    steps = DRIVES["long"](90.0, 3).model_dump()["steps"]
    findings = found_in(tmp_path, config, on_rows(steps), 90.0)
    (named,) = (
        f
        for f in findings.findings
        if f.verdict in (Verdict.NAMED, Verdict.NAMED_GROUP)
    )
    assert "rotation_gain" in named.causes
    assert set(named.causes) <= {"rotation_gain", "friction_anisotropy"}
    found = named.parameters["rotation_gain"]
    low, high = found.ci95
    # K_om of this body is 1.0 (tests of turning)
    turning = 1.0 / RobotParameters().k_om - 1.0
    assert low < turning < high or found.value == pytest.approx(turning, rel=0.1)
    gain = findings.total_gain["yaw_rad"]
    assert gain.ratio > 3.0
    assert gain.ci95[0] > 1.0


@pytest.mark.long
@pytest.mark.parametrize(
    ("seconds", "seed", "gyro_sd", "within"),
    [(90.0, 3, 0.006, True), (90.0, 4, 0.0005, False), (180.0, 12, 0.006, False)],
)
def test_the_wheel_radius_of_a_mecanum_body_is_named(
    tmp_path, seconds, seed, gyro_sd, within
):
    """Rollers slip at every step of a set-point, which may hide how large it is."""
    plant = {"drive": "mecanum", "wheel_radius_m": 0.05}
    model = Config.model_validate({"plant": plant})
    body = {"enabled": True, "sensors": "body"}
    plant = plant | {"wheel_radius_m": 0.05 * 1.12}
    config = Config.model_validate({"plant": plant, "mechatronic": body})
    scenario = on_rows(omni(seconds, seed))
    findings = found_in(tmp_path, config, scenario, seconds, model, **{GYRO: gyro_sd})
    named = [
        f
        for f in findings.findings
        if f.verdict in (Verdict.NAMED, Verdict.NAMED_GROUP)
    ]
    (found,) = (f for f in named if not {"body_lag", "imu_latency"} & set(f.causes))
    assert "wheel_radius" in found.causes
    low, high = found.parameters["wheel_radius"].ci95
    assert low < 0.12 < high or not within


@pytest.mark.long
def test_a_blocked_spell_is_said_and_names_no_cause(tmp_path):
    (tmp_path / "hall.yaml").write_text(
        "walls: [[1.5, -9, 1.5, 9]]\n", encoding="utf-8"
    )
    config = Config.model_validate(
        {
            "mechatronic": {"enabled": True, "sensors": "body"},
            "sensors": {"tof": {"hall": str(tmp_path / "hall.yaml")}},
        }
    )
    into_the_wall = [(0.5, 45.0), (12.0, -45.0), (19.0, 0.0)]
    steps = [{"at_s": at_s, "write": wheels(rpm, 0.0)} for at_s, rpm in into_the_wall]
    later = DRIVES["long"](39.0, 3).model_dump()["steps"]
    steps += [{**step, "at_s": step["at_s"] + 19.5} for step in later]
    findings = found_in(tmp_path, config, on_rows(steps), 60.0)
    assert any(
        "stood still once although its wheels were turning" in note
        for note in findings.notices
    )
    assert all(f.verdict == Verdict.STRUCTURE_NOT_IN_LIBRARY for f in findings.findings)


@pytest.mark.parametrize(
    "mass_kg", [5.0, 50.0], ids=["the wheels slip", "the wheels stall"]
)
def test_the_body_at_a_wall_is_seen_to_be_blocked(mass_kg):
    wall = wall_solids(np.array([3.0, -2.0, 3.0, 2.0]))
    tyre = {"v0_m_s": 0.05}
    body = Body(torque=True, sensors=True, solids=wall, mass_kg=mass_kg, tyre=tyre)
    rows = []
    for duty in [50.0] * 700 + [-50.0] * 600:
        body.run(0.02, *[duty] * 4)
        asked = 55.0 * np.sign(duty) * MIRROR
        speeds = body.b.speed * MIRROR * 30.0 / math.pi
        rows.append([*asked, *speeds, body.velocity[2], *body.place[:2], body.yaw])
    columns = dict(
        zip((*SETPOINTS, *SPEEDS, GYRO, *TAG), np.array(rows).T, strict=True)
    )
    log, found = blocked.find(
        log_of(GRID_S * np.arange(len(rows)), columns), RobotParameters()
    )
    assert found == []
    assert any(
        "stood still once although its wheels were turning" in note
        for note in log.notices
    )
    assert len(log.spans) == 2
