"""Shadow mode: alarms of the gap in virtual time, and the pose behind a navigation tag."""

import math

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from hilserver.config.monitoring import ShadowConfig
from hilserver.config.root import Config
from hilserver.core.events import EventBus, EventKind
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.shadow import GapWatch, measured_pose
from hilserver.errors import ConfigError
from hilserver.image import Frame
from hilserver.plant.layout import Parameters
from hilserver.status import UNCERTAIN_LAST_USABLE_VALUE
from tests.fakes import make_table

TABLE = make_table()


class World:
    """A watch over one gap, with a clock of its own."""

    def __init__(self):
        self.now_s, self.gaps, self.events = 0.0, {}, EventBus()
        config = ShadowConfig(limits={"pose.x_m": 0.3}, after_s=1.0)
        self.watch = GapWatch(
            config, TABLE, lambda: self.gaps, self.events,
            monotonic_ns=lambda: round(self.now_s * 1e9),
        )  # fmt: skip

    def run(self, gap, until_s):
        self.gaps = {} if gap is None else {"pose.x_m": gap}
        while self.now_s < until_s:
            self.now_s = round(self.now_s + 0.1, 6)
            self.watch.run()
        return [event.message for event in self.events.recent]


def test_a_gap_that_lasts_is_told_once_and_its_end_too():
    world = World()
    assert world.run(0.2, 3.0) == []
    assert world.run(0.4, 4.0) == []
    (told,) = world.run(-0.4, 8.0)
    assert (
        told == "model gap: pose.x_m: measured minus simulated is -0.4 m, limit 0.3 m"
    )
    assert world.watch.alarms == {"pose.x_m": True}
    assert "within its limit again" in world.run(0.1, 9.0)[-1]
    assert world.watch.alarms == {"pose.x_m": False}
    assert all(event.kind is EventKind.MODEL_GAP for event in world.events.recent)


def test_a_short_gap_is_no_alarm():
    world = World()
    for k in range(10):
        world.run(9.0, 2 * k + 0.9)
        assert world.run(0.0, 2 * k + 2) == []


def test_what_falls_silent_is_no_alarm_any_more():
    world = World()
    world.run(1.0, 2.0)
    assert "no longer measured" in world.run(None, 3.0)[-1]
    assert not world.watch.alarms["pose.x_m"]


def given(stale=(), **values):
    """What `measured_pose` looks at, with a pose for each group in `values`."""
    newest, status = {}, np.zeros(TABLE.n_slots, dtype=np.int64)
    for group, pose in values.items():
        for name, value in zip(("x_m", "y_m", "yaw_rad"), pose, strict=True):
            newest[f"measured.{group}.{name}"] = value
    for name in stale:
        status[TABLE.slot(name)] = UNCERTAIN_LAST_USABLE_VALUE
    return newest.get, TABLE, Frame(0, 0, 0, 0, np.zeros(TABLE.n_slots), status)


def parameters(lever=(0.0, 0.0), scale=1.0, frame_yaw=0.0):
    p = Parameters.zeros()
    p.lever_x, p.lever_y = lever
    p.nav_scale, p.nav_frame_yaw = scale, frame_yaw
    return p


def test_the_measured_pose_is_preferred_and_nothing_is_made_up():
    p = parameters()
    both = {"pose": (1, 2, 0.5), "nav": (9, 9, 1)}
    assert measured_pose(*given(**both)[:2], None, p) is None
    assert measured_pose(*given(), p) is None
    assert measured_pose(*given(**both), p) == (1, 2, 0.5)
    assert measured_pose(*given(["measured.pose.x_m"], **both), p) == (9, 9, 1)


@hypothesis.given(
    *[st.floats(-5, 5)] * 2,
    st.floats(-3.1, 3.1),
    st.floats(-0.5, 0.5),
    st.floats(0.8, 1.2),
)
def test_the_tags_place_scale_and_frame_are_taken_off(x, y, yaw, turned, scale):
    lever = (0.2, -0.1)
    nav = (
        scale * (x + lever[0] * math.cos(yaw) - lever[1] * math.sin(yaw)),
        scale * (y + lever[0] * math.sin(yaw) + lever[1] * math.cos(yaw)),
        math.remainder(yaw + turned, math.tau),
    )
    found = measured_pose(*given(nav=nav), parameters(lever, scale, turned))
    assert found == pytest.approx((x, y, yaw), abs=1e-9)


def test_a_limit_for_what_nothing_measures_is_refused():
    config = Config.model_validate({"shadow": {"limits": {"pose.z_m": 1.0}}})
    with pytest.raises(
        ConfigError, match=r"shadow\.limits\.pose\.z_m: there is no measured value"
    ):
        assemble_config(config)
