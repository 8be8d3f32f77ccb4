"""Halls from files: walls for the range finders, solids for the mechatronic model."""

import math

import numpy as np
import pytest

from hilserver.config.hall import load_hall
from hilserver.plant.errors import PlantError

HUGE = 10**400


def hall(tmp_path, text):
    (tmp_path / "hall.yaml").write_text(text, encoding="utf-8")
    return load_hall("hall.yaml", tmp_path)


def test_a_wall_is_a_box_around_its_line(tmp_path):
    found = hall(tmp_path, "walls: [[1, -2, 1, 2]]\nheight_m: 0.4\nthickness_m: 0.1\n")
    (solid,) = found.solids
    assert solid.centre_m == (1.0, 0.0, 0.2)
    assert solid.half_m == pytest.approx((2.05, 0.05, 0.2))
    assert (solid.yaw_rad, solid.carries) == (math.pi / 2, False)


def test_a_slope_rises_from_the_floor_to_its_height(tmp_path):
    text = "walls: []\nslopes: [{from: [1, 0], to: [1, 2], width_m: 1, rise_m: 0.5}]\n"
    (solid,) = hall(tmp_path, text).solids
    pitch, yaw = solid.pitch_rad, solid.yaw_rad
    along = np.array(
        [
            math.cos(yaw) * math.cos(pitch),
            math.sin(yaw) * math.cos(pitch),
            math.sin(pitch),
        ]
    )
    up = np.array(
        [
            -math.cos(yaw) * math.sin(pitch),
            -math.sin(yaw) * math.sin(pitch),
            math.cos(pitch),
        ]
    )
    top = np.array(solid.centre_m) + solid.half_m[2] * up
    assert top - solid.half_m[0] * along == pytest.approx((1.0, 0.0, 0.0), abs=1e-12)
    assert top + solid.half_m[0] * along == pytest.approx((1.0, 2.0, 0.5), abs=1e-12)
    assert solid.carries


def test_the_range_finders_see_boxes_and_no_thresholds(tmp_path):
    text = (
        "walls: [[5, -2, 5, 2]]\n"
        "boxes: [{centre: [2, 0], size: [1, 0.4, 0.3]}]\n"
        "thresholds: [{from: [1, -1], to: [1, 1], width_m: 0.04, height_m: 0.01}]\n"
    )
    found = hall(tmp_path, text)
    assert found.walls.size == 4 * 5
    assert np.min(found.walls.reshape(-1, 4)[1:, 0]) == 1.5
    assert [solid.carries for solid in found.solids] == [False, True, False]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("walls: []\nfloor: 1\n", "'floor' is not a key of a hall; the keys are walls"),
        (
            "walls: []\nheight_m: 0\n",
            "height_m and thickness_m must be numbers above 0",
        ),
        (
            "walls: []\nboxes: [{centre: [1, 2]}]\n",
            "boxes, number 1: must be {centre, size",
        ),
        ("walls: []\nboxes: 3\n", "boxes must be a list"),
        (
            "walls: []\nslopes: [{from: [0, 0], to: [1], width_m: 1, rise_m: 1}]\n",
            "slopes, number 1",
        ),
        ("walls: []\nslopes: [[1]]\n", "slopes, number 1"),
        (f"walls: []\nheight_m: {HUGE}\n", "height_m and thickness_m must be numbers"),
        (f"walls: [[0, 0, 1, {HUGE}]]\n", "wall 1 must be four finite numbers"),
        (
            f"walls: []\nboxes: [{{centre: [0, 0], size: [1, 1, {HUGE}]}}]\n",
            "boxes, number 1",
        ),
        (
            f"walls: []\nslopes: [{{from: [0, 0], to: [1, 0], width_m: {HUGE}, rise_m: 1}}]\n",
            "slopes, number 1",
        ),
    ],
)
def test_a_mistake_is_one_sentence(tmp_path, text, words):
    with pytest.raises(PlantError, match=r"sensors\.tof\.hall") as caught:
        hall(tmp_path, text)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
