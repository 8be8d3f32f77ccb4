"""Small sweeps in a folder: a straight drive, a block with a known limit, controllers."""

import json

import pytest

from hilserver.sweep.prepare import prepare

COURSE = """
steps:
  - {at_s: 0.0, write: {control.mode: 1, twist.linear_m_s: 0.3}}
  - {at_s: 0.6, write: {twist.linear_m_s: 0.0}}
"""
LIMIT = """
from hilserver.plant.blocks import Output, block

@block(inputs=("x_m",), outputs=(Output("margin"), Output("speed_m_s")),
       parameters={"a": 0.0, "b": 0.0, "c": 0.0, "raises": 0.0})
def limit(dt_s, u, y, x, p):
    y[0] = p[0] - 2.0 * p[1]
    y[1] = 0.2
    if p[3] > 0.0 and u[0] > 0.01:
        y[300] = 1.0  # outside: it raises
"""
CONTROLLER = """
class Controller:
    def __call__(self, time_s, signals):
        ahead = 0.1 - signals["pose.x_m"]
        turn = max(-1.0, min(1.0, -2.0 * signals["pose.y_m"] - signals["pose.yaw_rad"]))
        forward = max(-0.3, min(0.3, 2.0 * ahead))
        return {"control.mode": 1, "twist.linear_m_s": forward, "twist.angular_rad_s": turn}
"""
BASIC = {
    "machines": 6,
    "seed": 7,
    "from": {
        "population": {
            "rotation_gain": {"sd": 0.05},
            "wheel_radius_difference": {"sd": 0.02},
            "battery.initial_charge": {"uniform": [0.2, 1]},
        }
    },
    "drive": {"scenario": "course.yaml", "duration_s": 1.0},
    "require": [
        {"name": "straight", "signal": "pose.y_m", "above": -0.002, "below": 0.002},
        {"name": "arrives", "signal": "pose.x_m", "above": 0.1, "within_s": 0.9},
    ],
}


@pytest.fixture
def write(tmp_path):
    """Write a sweep that differs from the basic one in some sections; return its path."""
    (tmp_path / "course.yaml").write_text(COURSE)
    (tmp_path / "limit.py").write_text(LIMIT)
    (tmp_path / "my.py").write_text(CONTROLLER)

    def written(name="sweep.yaml", **sections):
        path = tmp_path / name
        path.write_text(json.dumps(BASIC | sections))
        return path

    return written


@pytest.fixture
def made(write):
    """Prepare a sweep."""
    return lambda **sections: prepare(write(**sections))


@pytest.fixture
def limit():
    """Sections of a sweep whose margin is a - 2 b, whatever c is."""
    population = {f"limit.{name}": {"uniform": [-1.0, 1.0]} for name in "abc"}
    return {
        "from": {"population": population},
        "drive": {"duration_s": 0.05},
        "controller": {
            "block": "limit.py:limit",
            "inputs": {"x_m": "pose.x_m"},
            "drives": {"speed_m_s": "twist.linear_m_s"},
        },
        "require": [
            {"name": "limit", "signal": "limit.margin", "above": 0.0, "after_s": 0.02}
        ],
    }
