"""An effect in a recording: the replay that has it fits as well as the one before it did."""

import numpy as np
import pytest
from hilserver_injector import make

from benchmarks.diagnose_worker import measured
from hilserver.diagnosis.power.effects import with_effect
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.diagnosis.replay.model import Fitted
from hilserver.measured.channels import POSITION
from hilserver.measured.machine import machine
from hilserver.plant.parameters import RobotParameters
from tests.diagnosis.hidden.logs import recipe


@pytest.fixture(scope="module")
def drive():
    """A log of a sound machine, its robot and its stages."""
    log = measured(make(recipe("nothing drive", 3, 75.0))[0])
    robot = machine(log, RobotParameters())
    return log, robot, stages_of(log, robot)


def candidate(stages, label):
    return next(
        one
        for stage in stages.values()
        for one in stage.candidates()
        if one.label == label
    )


def misfit(stages, name, terms):
    """Root mean square of what a stage's channels show beyond a replay."""
    stage = stages[name]
    shown = stage.predict(terms, stage.start_poses(terms))
    left = stage.difference(stage.stack.values, shown)
    return {n: float(left[e].std()) for n, e in stage.stack.edges.items()}


@pytest.mark.parametrize(
    ("label", "value"),
    [("rotation_gain", 0.1), ("gyro_scale", 0.1), ("coulomb_friction", 10.0)],
)
def test_the_replay_with_the_effect_fits_as_well_as_without(drive, label, value):
    log, robot, stages = drive
    one = candidate(stages, label)
    effect = Fitted(one, (value,))
    changed = with_effect(log, robot, effect)
    after = stages_of(changed, robot)
    for name in stages:
        terms = effect.terms if name == one.stage else {}
        before, now = misfit(stages, name, {}), misfit(after, name, terms)
        for channel, spread in before.items():
            assert now[channel] < 1.25 * spread + 1e-9, channel
    as_if_sound = misfit(after, one.stage, {})
    before = misfit(stages, one.stage, {})
    assert any(as_if_sound[n] > 1.5 * spread for n, spread in before.items())


def test_no_effect_changes_nothing(drive):
    log, robot, stages = drive
    one = candidate(stages, "rotation_gain")
    changed = with_effect(log, robot, Fitted(one, one.null))
    for name, channel in stages["pose"].log.channels.items():
        assert np.allclose(changed[name].values, channel.values, atol=1e-9), name


def test_it_adds_up_along_the_drive_without_jumps(drive):
    log, robot, stages = drive
    assert len(stages["pose"].segments) > 2
    effect = Fitted(candidate(stages, "rotation_gain"), (0.2,))
    changed = with_effect(log, robot, effect)
    recorded = stages["pose"].log
    off = [changed[n].values - recorded[n].values for n in POSITION]
    apart_m = np.hypot(*off)
    steps_m = np.hypot(*(np.diff(one) for one in off))
    assert apart_m.max() > 0.5
    assert steps_m.max() < 0.2 * apart_m.max()
