"""UMBmark squares of a real robot, of which only the first and the last pose of a run is kept."""

from pathlib import Path

import numpy as np
import pytest

from hilserver.diagnosis.findings.other_logs import OtherLogs
from hilserver.diagnosis.marks.judging import judge_marks
from hilserver.diagnosis.regression.gain import HORIZON_S
from hilserver.diagnosis.replay.model import Model
from hilserver.measured.channels import POSITION, YAW
from hilserver.measured.machine import machine
from hilserver.measured.marks import with_marks
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters
from tests.helpers.recordings import recording

MAPPING = Path(__file__).parents[3] / "docs" / "how-to" / "mappings" / "diffdrive.yaml"
WHOLE_POSE = 2.5
"""Gain in position on the circles where the whole pose of the squares is known, at least 2.4."""


def ends(log):
    """Return the marks that somebody would have written who measured where each run ended."""
    lines = ["marks:"]
    for index, span in enumerate(log.spans):
        t_s = log[YAW].of(index)[0]
        pose = [log[name].of(index)[1] for name in (*POSITION, YAW)]
        for row in (0, -1):
            x, y, yaw = (float(values[row]) for values in pose)
            lines.append(
                f"  - {{t_s: {t_s[row]:.3f}, segment: {span.number}, x_m: {x:.4f}, y_m: {y:.4f},"
                f" yaw_rad: {yaw:.4f}, sd_m: 0.005, yaw_sd_rad: 0.005}}"
            )
    return "\n".join(lines)


@pytest.mark.long
def test_ends_of_squares_gain_on_circles_nearly_what_the_whole_pose_gains(tmp_path):
    folder = recording("diffdrive_umbmark")
    squares, circles = (
        read_measured(sorted(folder.glob(f"{kind}_*.csv")), MAPPING)
        for kind in ("square", "circular")
    )
    path = tmp_path / "marks.yaml"
    path.write_text(ends(squares))
    log = with_marks(squares.without([*POSITION, YAW]), path)
    robot, rng = machine(log, RobotParameters()), np.random.default_rng(0)

    found = judge_marks(log, robot, {}, rng, lambda *_: None)
    assert {"rotation_gain", "wheel_radius_difference"} <= {
        cause for finding in found.findings for cause in finding.causes
    }
    patch = {"pose": Model(found.fitted)}
    others = OtherLogs.of(circles, robot, patch, HORIZON_S)
    gain = others.gains(rng, of_patch=True)
    assert gain["position_m"].ratio >= 0.8 * WHOLE_POSE
