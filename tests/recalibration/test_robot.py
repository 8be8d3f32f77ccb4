"""The "real robot" of the twin: one drive after the other without a jump, then a cause."""

import itertools

import numpy as np

from hilserver.recalibration import robot
from hilserver.recalibration.robot import MEASURES, peer, rows


def test_one_drive_goes_on_where_the_one_before_has_ended(monkeypatch):
    monkeypatch.setattr(robot, "APPEARS_S", 6.0)
    monkeypatch.setattr(robot, "DRIVE_S", 8.0)
    taken = list(itertools.takewhile(lambda row: row[0] < 20.0, rows(seed=3)))
    t_s = np.array([t for t, _ in taken])
    assert (np.diff(t_s) > 0.0).all()
    assert np.diff(t_s).max() < 0.1
    places = [
        (t, v["nav.x_m"], v["nav.y_m"]) for t, v in taken if {"nav.x_m", "nav.y_m"} <= v.keys()
    ]
    steps = np.diff(np.array(places), axis=0)
    assert np.hypot(steps[:, 1], steps[:, 2]).max() < 0.6  # noise of ranging, and 0.1 m of way


def test_everything_that_it_measures_is_an_input_of_ours():
    signals = peer("opc.tcp://127.0.0.1:4840/UA/Robot").read.values()
    assert {f"measured.{name}" for name in MEASURES} < set(signals)
