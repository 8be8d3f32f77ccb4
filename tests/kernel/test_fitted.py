"""Outside the range a term was fitted in, what it changes is Uncertain, and nothing else."""

from contextlib import closing

import pytest

from hilserver.config.patch import ModelPatch, Patch
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.image import Row
from hilserver.scheduler.step import LATCH, PUBLISH
from hilserver.status import GOOD, UNCERTAIN

CONFIG = Config.model_validate({"sensors": {"nav": {"enabled": True}}})
MADE = {"findings_sha256": "", "config_sha256": CONFIG.sha256, "version": "1"}
UNITS = {"rotation_gain": "1", "nav_scale": "1", "gyro_scale": "1", "process_gain": "1"}


def patch(name, value=0.01, **fitted_in):
    term = {"value": value, "unit": UNITS[name], "fitted_in": fitted_in}
    data = {
        "schema": "hilserver.model_patch/1",
        "made_from": MADE,
        "terms": {name: term},
    }
    return Patch(ModelPatch.model_validate(data))


class Plant:
    """A composed step driven by hand at constant wheel speeds."""

    def __init__(self, laid_over=None):
        assembly = assemble_config(CONFIG, patch=laid_over)
        core = build(assembly)
        self.table, self.image, self.step = assembly.table, core.image, core.step
        self.close = self.image.close
        self._n_slices = len(assembly.composition.slices)

    def drive(self, rpm, n_ticks=300):
        """Straight on, from rest; return the last frame."""
        for name, sign in (("fl", 1), ("rl", 1), ("fr", -1), ("rr", -1)):
            slot = self.table.slot(f"wheel.{name}.setpoint_rpm")
            assert self.image.push([Row(slot, sign * rpm)])
        arena = self.image.values, self.image.words
        for tick in range(n_ticks):
            for phase in (LATCH, *range(self._n_slices), PUBLISH):
                self.step(phase, tick, 0, *arena)
        return self.image.latest()

    def uncertain(self, rpm):
        frame = self.drive(rpm)
        return {
            s.name for s in self.table.scalars if frame.status[s.slots[0]] == UNCERTAIN
        }


@pytest.mark.parametrize(
    ("term", "flagged", "good"),
    [
        (
            "rotation_gain",
            {"pose.x_m", "imu.gyro_z_rad_s", "nav.x_m"},
            {"wheel.fl.speed_rpm"},
        ),
        ("nav_scale", {"nav.x_m", "nav.yaw_rad"}, {"pose.x_m", "imu.gyro_z_rad_s"}),
        ("gyro_scale", {"imu.gyro_z_rad_s"}, {"pose.x_m", "nav.x_m"}),
        ("process_gain", {"wheel.fl.speed_rpm", "pose.x_m"}, {"battery.voltage_v"}),
    ],
)
def test_the_blocks_outputs_are_flagged_outside_only(term, flagged, good):
    with closing(Plant(patch(term, speed_m_s=[-0.1, 0.2]))) as plant:
        assert not plant.uncertain(rpm=10)
        outside = plant.uncertain(rpm=60)
        assert flagged <= outside
        assert not good & outside
        assert "sim.tick" not in outside
        assert not plant.uncertain(rpm=10)


@pytest.mark.parametrize(
    "fitted_in", [{"turn_rate_rad_s": [0.5, 1.0]}, {"wheel_speed_rpm": [-50, 50]}]
)
def test_every_kind_of_range_counts(fitted_in):
    with closing(Plant(patch("rotation_gain", **fitted_in))) as plant:
        assert "pose.yaw_rad" in plant.uncertain(rpm=60)


def test_without_a_range_nothing_is_said():
    with closing(Plant(patch("rotation_gain"))) as plant:
        assert not plant.uncertain(rpm=60)


def test_flags_change_no_value_and_no_patch_no_status():
    with (
        closing(Plant(patch("rotation_gain", 0.0, speed_m_s=[0, 0.1]))) as flagged,
        closing(Plant()) as plain,
    ):
        a, b = flagged.drive(60), plain.drive(60)
        assert a.values.tobytes() == b.values.tobytes()
        assert UNCERTAIN in a.status
        assert UNCERTAIN not in b.status
        assert GOOD in b.status
