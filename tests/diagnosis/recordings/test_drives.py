"""Real recordings of other people's robots, through the mapping files of the documentation."""

from pathlib import Path

import pytest

from hilserver.diagnosis.engine import judge
from hilserver.diagnosis.reading import read_measured
from hilserver.plant.parameters import RobotParameters
from tests.diagnosis.uwb_trolley import recording

MAPPINGS = Path(__file__).parents[3] / "docs" / "how-to" / "mappings"


def diagnosed(names, mapping, test=()):
    read = [read_measured(files, MAPPINGS / f"{mapping}.yaml") for files in (names, test) if files]
    return judge(read[0], RobotParameters(), test=read[1] if test else None).findings


def causes(findings):
    return {cause for f in findings.findings for cause in f.causes}


@pytest.mark.parametrize(
    ("name", "mapping", "yaw", "position"),
    [
        ("husky_mixed", "husky", 9.0, 2.6),
        ("warthog_asphalt", "warthog", 4.1, 2.2),
        ("warthog_gravel", "warthog", 3.5, 1.6),
        ("warthog_sand", "warthog", 3.4, 1.6),
    ],
)
def test_skid_steering_gains_on_held_out_blocks(name, mapping, yaw, position):
    found = diagnosed([recording("skidsteer_drive") / f"{name}.csv"], mapping)
    assert found.total_gain["yaw_rad"].ratio >= yaw
    assert found.total_gain["position_m"].ratio >= position
    assert "rotation_gain" in causes(found)
    # Place and heading in the room are unknown: each segment begins at nought.
    assert not causes(found) & {"surface_change", "floor_slope", "heading_distortion"}
    gyro = [f for f in found.findings if f.causes == ("sign_flip",)]
    assert bool(gyro) == (name == "warthog_gravel")


def test_differential_drive_learns_from_squares_for_circles():
    folder = recording("diffdrive_umbmark")
    squares, circles = (sorted(folder.glob(f"{kind}_*.csv")) for kind in ("square", "circular"))
    found = diagnosed(squares, "diffdrive", circles)
    assert found.total_gain["position_m"].ratio >= 2.4
