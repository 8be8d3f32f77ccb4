"""Real recordings of other people's robots, through the mapping files of the documentation."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.engine import compare, judge
from hilserver.diagnosis.schema.findings import Overall
from hilserver.measured.data import Channel
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters
from tests.helpers.recordings import recording

MAPPINGS = Path(__file__).parents[3] / "docs" / "how-to" / "mappings"


def diagnosed(names, mapping, test=()):
    read = [
        read_measured(files, MAPPINGS / f"{mapping}.yaml")
        for files in (names, test)
        if files
    ]
    return judge(read[0], RobotParameters(), test=read[1] if test else None).findings


def causes(findings):
    return {cause for f in findings.findings for cause in f.causes}


@pytest.mark.parametrize(
    ("name", "mapping", "yaw", "position"),
    [
        ("husky_mixed", "husky", 8.5, 2.6),
        ("warthog_gravel", "warthog", 3.5, 1.6),
        # the same machine on other ground, without the sign that gravel shows
        pytest.param("warthog_asphalt", "warthog", 4.1, 2.2, marks=pytest.mark.long),
        pytest.param("warthog_sand", "warthog", 3.4, 1.6, marks=pytest.mark.long),
    ],
)
def test_skid_steering_gains_on_held_out_blocks(name, mapping, yaw, position):
    found = diagnosed([recording("skidsteer_drive") / f"{name}.csv"], mapping)
    assert found.total_gain["yaw_rad"].ratio >= yaw
    assert found.total_gain["position_m"].ratio >= position
    assert "rotation_gain" in causes(found)
    # Place and heading in the room are unknown: each segment begins at zero.
    assert not causes(found) & {"surface_change", "floor_slope", "heading_distortion"}
    gyro = [f for f in found.findings if f.causes == ("sign_flip",)]
    assert bool(gyro) == (name == "warthog_gravel")


@pytest.mark.parametrize(
    ("name", "mapping"),
    [
        ("husky_mixed", "husky"),
        ("warthog_asphalt", "warthog"),
        ("warthog_gravel", "warthog"),
        ("warthog_sand", "warthog"),
    ],
)
def test_two_parts_of_one_recording_do_not_differ(name, mapping):
    file = recording("skidsteer_drive") / f"{name}.csv"
    log = read_measured([file], MAPPINGS / f"{mapping}.yaml")
    found = compare(part(log, 0), part(log, 1), assemble(None)).findings
    assert found.verdict == Overall.NO_DIFFERENCE


def part(log, first, of=4):
    """Every fourth of the log's blocks, by rank: the files hold even block numbers only."""
    rank = {block: i for i, block in enumerate(sorted({s.block for s in log.spans}))}
    kept = [i for i, s in enumerate(log.spans) if rank[s.block] % of == first]
    number = np.full(len(log.spans), -1)
    number[kept] = np.arange(len(kept))
    channels = {}
    for name, channel in log.channels.items():
        span = number[channel.span]
        mine = span >= 0
        channels[name] = Channel(channel.t_s[mine], channel.values[mine], span[mine])
    return replace(log, channels=channels, spans=tuple(log.spans[i] for i in kept))


@pytest.mark.long
def test_differential_drive_learns_from_squares_for_circles():
    folder = recording("diffdrive_umbmark")
    squares, circles = (
        sorted(folder.glob(f"{kind}_*.csv")) for kind in ("square", "circular")
    )
    found = diagnosed(squares, "diffdrive", circles)
    assert found.total_gain["position_m"].ratio >= 2.4
    assert {"rotation_gain", "wheel_radius_difference"} <= causes(found)
