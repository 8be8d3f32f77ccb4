"""The "real robot" of the twin: one drive after the other without a jump, then a cause."""

import itertools
import time

import numpy as np

from hilserver.controller.nodes import SEQUENCE
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
        (t, v["nav.x_m"], v["nav.y_m"])
        for t, v in taken
        if {"nav.x_m", "nav.y_m"} <= v.keys()
    ]
    steps = np.diff(np.array(places), axis=0)
    # noise of ranging, and 0.1 m of way
    assert np.hypot(steps[:, 1], steps[:, 2]).max() < 0.6


async def test_a_robot_that_was_late_does_not_catch_up(monkeypatch):
    """It is held up for 0.3 s after its fifth row; the position of a row left out is not lost."""
    made = [
        {"wheel.fl.speed_rpm": k} | ({"nav.x_m": k} if k == 10 else {})
        for k in range(30)
    ]
    monkeypatch.setattr(
        robot, "rows", lambda _: ((0.02 * k, v) for k, v in enumerate(made))
    )
    served = []

    class Server:
        async def offer(self, values, _stamp):
            served.append(values)
            if len(served) == 5:
                time.sleep(0.3)  # noqa: ASYNC251 - nothing else runs meanwhile

    await robot.drive(Server(), 1)
    places = [values["wheel.fl.speed_rpm"] for values in served]
    assert places == sorted(places)
    assert places[5] >= places[4] + 14
    assert [v["nav.x_m"] for v in served if "nav.x_m" in v] == [10]
    assert [values[SEQUENCE] for values in served] == list(range(1, len(served) + 1))


def test_everything_that_it_measures_is_an_input_of_ours():
    signals = peer("opc.tcp://127.0.0.1:4840/UA/Robot").read.values()
    assert {f"measured.{name}" for name in MEASURES} < set(signals)
