"""A diagnosis made up for tests: the page has to show whatever it is given."""

import numpy as np

from hilserver.config.patch import FittedIn
from hilserver.diagnosis.catalogue.vocabulary import CAUSES
from hilserver.diagnosis.findings.explain import separating_experiment
from hilserver.diagnosis.schema.decisions import Decision, ScreenRow
from hilserver.diagnosis.schema.evidence import (
    ChannelSeries,
    Course,
    CutRow,
    Dependence,
    Evidence,
    FittedTerm,
    HorizonRow,
    Path,
    Similarity,
)
from hilserver.diagnosis.schema.findings import (
    Detectable,
    Finding,
    Findings,
    Gain,
    LogFile,
    Noise,
    NotJudged,
    Parameter,
)

GROUP = ("icr_offset", "nav_lever_arm")
ROTATION = Parameter(value=-0.47, ci95=(-0.48, -0.46), unit="1")


def gain(before, after, low, high, horizon_s=5.0):
    return Gain(
        horizon_s=horizon_s,
        before=before,
        after=after,
        ratio=before / after,
        ci95=(low, high),
    )


def gain_of(horizon_s, before, ratio, ci95):
    return Gain(
        horizon_s=horizon_s, before=before, after=before / ratio, ratio=ratio, ci95=ci95
    )


def noise_of(white_sd, ou_sd=0.0, ou_tau_s=None, tail_dof=None):
    return Noise(white_sd=white_sd, ou_sd=ou_sd, ou_tau_s=ou_tau_s, tail_dof=tail_dof,
                 step=None, limits=None)  # fmt: skip


def findings(**changes):
    """Two causes, one fault of the data, one unknown structure."""
    everything = {
        "verdict": "findings",
        "logs": (LogFile(file="hall <3>.csv", sha256="5a" * 32),),
        "seed": 0,
        "version": "0.4.0",
        "config_sha256": "c0" * 32,
        "baseline": {"position_m": 0.31, "yaw_rad": 0.31},
        "findings": (
            Finding(
                verdict="named",
                causes=("rotation_gain",),
                block="kinematics",
                parameters={"rotation_gain": ROTATION},
                p_adjusted=0.001,
                gain={"yaw_rad": gain(0.31, 0.04, 6.1, 9.0)},
            ),
            Finding(
                verdict="named_group",
                causes=GROUP,
                block="kinematics",
                parameters={
                    "icr_offset": Parameter(value=0.06, ci95=(0.045, 0.074), unit="m"),
                    "nav_lever_arm.x": Parameter(
                        value=-0.06, ci95=(-0.074, -0.045), unit="m"
                    ),
                },
                p_adjusted=0.003,
                separating_experiment=separating_experiment(GROUP),
            ),
            Finding(
                verdict="structure_not_in_library",
                causes=(),
                block="kinematics",
                p_adjusted=0.004,
                regressors=("pose.yaw_rad", "t_s"),
            ),
            Finding(
                verdict="data_fault",
                causes=("unit_error",),
                block="data",
                parameters={
                    "unit_error.imu.gyro_z_rad_s": Parameter(
                        value=57.3, ci95=None, unit="1"
                    )
                },
            ),
        ),
        "total_gain": {
            "position_m": gain(0.31, 0.1, 2.7, 3.6),
            "yaw_rad": gain(0.31, 0.04, 6.1, 9.0),
            "speed_rpm": gain(1.4, 1.3, 0.98, 1.2),
        },
        "patch_gain": {
            "position_m": gain(0.31, 0.1, 2.7, 3.6),
            "yaw_rad": gain(0.31, 0.04, 6.1, 9.0),
            "speed_rpm": gain(1.4, 1.3, 0.98, 1.2),
        },
        "ceiling": {"position_m": 3.9},
        "noise": {
            "nav.x_m": noise_of(0.01, 0.05, 0.6, 4.2),
            "wheel.fl.speed_rpm": noise_of(0.12),
        },
        "smallest_detectable": tuple(
            Detectable(cause=c.name, size=0.1 * (p.reference or 0.3), unit=p.unit)
            for c in CAUSES.values()
            if c.physical
            for p in c.parts[:1]
        ),
        "not_judged": (
            NotJudged(cause="dead_zone", reason="no duty in the log"),
            NotJudged(cause="process_gain", reason="no duty in the log"),
        ),
        "notices": ("Row 18001 ends early and was dropped.",),
        "decisions": (
            Decision("rotation_gain", "taken", 7.7, "passes every gate"),
            Decision(
                "gyro_scale", "refused", 0.98, "brings nothing on held-out blocks"
            ),
        ),
        "model_patch": "model_patch.yaml",
    }
    return Findings.model_validate(everything | changes)


def nothing_found():
    return findings(
        verdict="nothing_found",
        baseline={"position_m": 0.07, "yaw_rad": 0.31},
        findings=(),
        total_gain={},
        patch_gain={},
        ceiling={},
        model_patch=None,
    )


def evidence(n=18000, seed=1):
    """Six minutes at 50 Hz of a robot that turns less than its model."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * 0.02
    span = np.zeros(n, dtype=np.int64)

    def way(k):
        v, om = 0.35 + 0.1 * np.sin(t / 9), k * (0.25 * np.sin(t / 7) + 0.12)
        yaw = np.cumsum(om) * 0.02
        x, y = np.cumsum(v * np.cos(yaw)) * 0.02, np.cumsum(v * np.sin(yaw)) * 0.02
        return np.column_stack([x, y]), yaw, v, om

    (true, yaw, v, om), (wrong, yaw_0, _, om_0), (close, yaw_1, _, om_1) = map(
        way, (0.53, 0.6, 0.531)
    )
    noise = rng.normal(size=(6, n))

    def series(name, unit, measured, simulated, extended):
        return ChannelSeries(name, unit, t, measured, simulated, extended, span)

    speed = v / 0.085 * 60 / (2 * np.pi)
    x = np.linspace(-3, 3, 24)
    bump = 0.01 * np.sin(2 * x)
    names = ("rotation_gain", "gyro_scale", "icr_offset", "nav_lever_arm.x", "side_slip",
             "nav_latency", "wheel_radius", "nav_scale", "gyro_bias")  # fmt: skip
    cosine = np.eye(9) + np.diag([0.3, 0, -1, 0, -0.97, 0, 0.99, 0.1], 1)
    cosine = np.clip(cosine + cosine.T - np.eye(9) + 0.05, -1, 1)
    return Evidence(
        series=(
            series("nav.x_m", "m", true[:, 0] + 0.05 * noise[0], wrong[:, 0], close[:, 0]),
            series("nav.yaw_rad", "rad", yaw + 0.015 * noise[1], yaw_0, yaw_1),
            series("imu.gyro_z_rad_s", "rad/s", om + 0.006 * noise[2], om_0, om_1),
            series("wheel.fl.speed_rpm", "rpm", speed + 0.12 * noise[3], speed, speed),
        ),
        paths=(Path(0, true + 0.03 * noise[4:6].T, wrong, close),),
        cuts=(
            CutRow("setpoints", "wheel.fl.speed_rpm", "rpm", 0.13, 0.12),
            CutRow("duty", "wheel.fl.speed_rpm", "rpm", 0.125, 0.12),
            CutRow("speed", "nav.yaw_rad", "rad", 0.11, 0.015),
        ),
        screen=tuple(
            ScreenRow(c, "", s, 3.4, min(1.0, 40 * np.exp(-s * s / 2)), 0.01 * s, 0.01,
                      CAUSES[c].unit, 38.0)
            for c, s in zip([c for c in CAUSES if CAUSES[c].physical],
                            [*np.abs(rng.normal(size=16)), 11.2, *np.abs(rng.normal(size=24))],
                            strict=False)
        ),
        similarity=Similarity(names, cosine),
        gain_by_horizon=tuple(
            HorizonRow(q, gain_of(h, 0.06 * h, r, (0.8 * r, 1.2 * r)))
            for h in (0.5, 1, 2, 5, 10, 20)
            for q, r in (("yaw_rad", 1.1 + 2.0 * np.log1p(h)), ("position_m", 1 + np.log1p(h)))
        ),
        dependences=(
            Dependence("nav.yaw_rad", "rad", "pose.yaw_rad", "rad", x, bump, bump - 0.003,
                       bump + 0.003, 6.1, 3.4),
        ),
        courses=(
            Course("rotation_gain", "1", x + 3, -0.47 + 0.01 * x, -0.48 + 0.01 * x,
                   -0.46 + 0.01 * x),
        ),
        extension=(FittedTerm("rotation_gain", ROTATION),),
        fitted=FittedIn(speed_m_s=(0.0, 0.46), turn_rate_rad_s=(-0.3, 0.4)),
        timings_s={"replay": 0.4, "screen": 2.1},
        remarks=("Bootstrap over 18 blocks.",),
    )  # fmt: skip
