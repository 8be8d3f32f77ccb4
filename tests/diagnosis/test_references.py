"""Machines of the injector, seen by satellites and by a map that corrects itself.

Such errors last: what is drawn here is correlated for a minute or two. The logs hold wheel speeds
and the reference alone, as those of most robots outdoors do.
"""

from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import Recipe, make
from hilserver_injector.recipe import Noise, Recorder

from benchmarks.diagnose_worker import measured
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.schema.findings import Verdict
from hilserver.measured.channels import POSITION, YAW
from hilserver.measured.corrections import cut_at_corrections
from tests.diagnosis.hidden.logs import assembly

SATELLITES = {
    "0.02 m": Noise(
        position_white_m=0.008, position_m=0.018, position_correlation_s=20.0
    ),
    "0.5 m": Noise(position_white_m=0.1, position_m=0.49, position_correlation_s=60.0),
    "3 m": Noise(position_white_m=0.3, position_m=3.0, position_correlation_s=120.0),
}
MAP = Noise(
    position_white_m=0.01, position_m=0.0, yaw_rad=0.004, yaw_correlation_s=0.05
)
DRIFT = {POSITION[0]: 0.02, POSITION[1]: 0.02, YAW: 0.004}  # per root of a second
CORRECTED_S = (35.0, 90.0)  # from one correction of the map to the next

SHOWN = {
    "0.02 m": {
        "rotation_gain": 0.03,
        "wheel_radius": 0.03,
        "wheel_radius_difference": 0.02,
        "nav_lever_arm.x": 0.08,
    },
    "0.5 m": {
        "rotation_gain": 0.12,
        "wheel_radius": 0.12,
        "wheel_radius_difference": 0.06,
        "nav_lever_arm.x": 0.25,
    },
    "3 m": {
        "rotation_gain": 0.3,
        "wheel_radius_difference": 0.2,
        "nav_lever_arm.x": 1.0,
    },
    "map": {
        "rotation_gain": 0.03,
        "wheel_radius": 0.06,
        "wheel_radius_difference": 0.03,
        "nav_lever_arm.x": 0.08,
    },
}
"""Sizes that these references show, by cause."""


def seen(kind, seed, causes=None, duration_s=360.0):
    """Return the log of a machine as a reference shows it."""
    if kind == "map":
        recorder, noise = Recorder(nav_hz=10.0, channels=("speed", "nav")), MAP
    else:
        recorder = Recorder(nav_hz=5.0, channels=("speed", "nav_position"))
        noise = SATELLITES[kind]
    recipe = Recipe(
        seed=seed,
        causes=causes or {},
        duration_s=duration_s,
        noise=noise,
        recorder=recorder,
    )
    log = replace(measured(make(recipe)[0]), pose_errors_last=True)
    return cut_at_corrections(drifted(log, seed)) if kind == "map" else log


def drifted(log, seed):
    """Return a log whose pose wanders until the map corrects it."""
    rng, moved = np.random.default_rng([seed, 1]), {}
    corrected_s = np.cumsum(rng.uniform(*CORRECTED_S, 20))
    for name, rate in DRIFT.items():
        channel = log[name]
        step_s = np.diff(channel.t_s, prepend=channel.t_s[0])
        away = np.cumsum(rate * np.sqrt(step_s) * rng.standard_normal(len(step_s)))
        part = np.searchsorted(corrected_s, channel.t_s)
        values = channel.values + away - away[np.searchsorted(part, part)]
        if name == YAW:
            values = np.angle(np.exp(1j * values))
        moved[name] = channel.with_values(values)
    return log.with_channels(moved)


def found_in(log):
    return diagnose(log, assembly(), seed=0, jobs=1).findings


def named(found):
    """Return the causes of each finding about the robot."""
    faults = (Verdict.DATA_FAULT, Verdict.INSUFFICIENT_EXCITATION)
    return [f.causes for f in found.findings if f.causes and f.verdict not in faults]


def test_satellites_of_half_a_metre_show_a_robot_that_turns_too_little():
    found = found_in(seen("0.5 m", 5, {"rotation_gain": -0.2}, duration_s=150.0))
    # Fixes are too rare to show that the turn is on time: friction would make it late.
    (causes,) = named(found)
    assert set(causes) == {"rotation_gain", "friction_anisotropy"}
    low, high = found.findings[0].parameters["rotation_gain"].ci95
    assert low < -0.2 < high
    reasons = {one.cause: one.reason for one in found.not_judged}
    assert reasons["nav_frame_yaw"] == "no navigation yaw in the log"


@pytest.mark.long
@pytest.mark.parametrize("kind", SHOWN)
def test_many_machines(kind):
    rng, right, wrong, inside = np.random.default_rng(3), 0, [], 0
    for number in range(30):
        cause = list(SHOWN[kind])[number % len(SHOWN[kind])]
        size = float(rng.choice([-1.0, 1.0])) * SHOWN[kind][cause]
        found = found_in(seen(kind, 2000 + number, {cause: size}))
        name = cause.partition(".")[0]
        causes = named(found)
        right += any(name in one for one in causes)
        wrong += [(cause, size, one) for one in causes if name not in one]
        for finding in found.findings:
            if cause in finding.parameters:
                low, high = finding.parameters[cause].ci95
                inside += low <= size <= high
    print(f"{kind}: named {right} of 30, in {inside} intervals, wrong: {wrong}")
    assert right >= 27
    assert not wrong
    assert inside >= 0.88 * right


@pytest.mark.long
@pytest.mark.parametrize("kind", SHOWN)
def test_many_sound_machines(kind):
    found = {seed: found_in(seen(kind, seed)).findings for seed in range(1000, 1100)}
    assert not {seed: one for seed, one in found.items() if one}
