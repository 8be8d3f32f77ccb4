"""The wheels between their samples."""

import numpy as np
import pytest

from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.encoders import as_turned, driven
from hilserver.diagnosis.replay.wheel_speeds import WheelSpeeds
from hilserver.measured.channels import SETPOINTS, SPEEDS
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span
from hilserver.plant.parameters import RobotParameters

ROBOT = RobotParameters()
ROW_S, ROWS = 0.02, 200


@pytest.mark.parametrize(
    "terms",
    [{"encoder_filter": 0.03}, {"encoder_scale.a": 0.1, "encoder_scale.wheel": 0.0}],
    ids=lambda terms: next(iter(terms)),
)
def test_between_samples_wheels_turn_as_they_do_whatever_their_encoders_show(terms):
    t_s = ROW_S * np.arange(ROWS)
    channel = Channel(t_s, np.zeros(ROWS), np.zeros(ROWS, dtype=np.int64))
    sent = {
        n: channel.with_values(40.0 * np.sign(np.sin(5.0 * t_s))) for n in SETPOINTS
    }
    channels = sent | dict.fromkeys(SPEEDS, channel)
    spans = (Span(0, None, 0.0, float(t_s[-1])),)
    log = MeasuredLog((LogSource("log.csv", "0" * 64),), channels, spans)
    drive = DriveStage(log, ROBOT, block_s=1.0)
    shown, edges = drive.predict(terms), drive.stack.edges
    log = log.with_channels({n: channel.with_values(shown[edges[n]]) for n in SPEEDS})
    wheels = WheelSpeeds(
        as_turned(log, ROBOT, terms), drive.segments, driven(drive, terms)
    )
    left, _ = wheels.sides()
    np.testing.assert_allclose(
        left, drive.simulate(terms)[0][:, :2].sum(axis=1), atol=1e-6
    )
