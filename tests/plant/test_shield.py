"""The shield: lamps as they blink, current, temperature."""

import numpy as np
import pytest

from hilserver.plant.layout import Outputs
from hilserver.plant.parameters import Battery
from hilserver.plant.shield import BLINK_S, TURN_S, WARMING_S
from hilserver.signals import LIGHTS
from hilserver.status import BAD_OUT_OF_SERVICE, GOOD
from tests.plant.rig import Rig


def lit(rig, pattern, runs=200):
    """Return the red of the lamps fl, fr, rl, rr over `runs` runs of 10 ms, shape (runs, 4)."""
    rig.u.light_pattern, rig.u.light_colour = LIGHTS.index(pattern), (200, 100, 0)
    lamps = rig.sensed(runs)[:, Outputs.where("lights")]
    return lamps.reshape(runs, 4, 3)[:, :, 0]


def test_every_pattern_shows_its_number_and_ends_with_off():
    rig = Rig()
    for number, pattern in enumerate(LIGHTS):
        lit(rig, pattern, 1)
        assert rig.y.light_pattern == number
    assert not lit(rig, "off").any()


def test_steady_patterns_keep_the_colour():
    rig = Rig()
    assert (lit(rig, "high beam") == 200).all()
    assert rig.y.lights[0].tolist() == [200, 100, 0]
    assert (lit(rig, "dim") == 70).all()


@pytest.mark.parametrize(
    ("pattern", "blinking"),
    [("flash all", {0, 1, 2, 3}), ("flash left", {0, 2}), ("flash right", {1, 3})],
)
def test_flashing_is_on_for_one_half(pattern, blinking):
    red = lit(Rig(), pattern, round(5 * BLINK_S / 0.01))
    assert red.mean(axis=0) == pytest.approx(
        [100 * (lamp in blinking) for lamp in range(4)], abs=4
    )
    assert set(np.unique(red)) <= {0, 200}


def test_rotation_lights_one_lamp_at_a_time_round_the_robot():
    red = lit(Rig(), "rotation", round(TURN_S / 0.01))
    assert ((red > 0).sum(axis=1) == 1).all()
    seen = list(dict.fromkeys(red.argmax(axis=1).tolist()))
    assert seen == [0, 1, 3, 2]


def test_running_alternates_between_the_sides():
    red = lit(Rig(), "running")
    assert ((red > 0).sum(axis=1) == 2).all()
    assert (red[:, 0] == red[:, 2]).all()
    assert (red[:, 0] != red[:, 1]).all()


def test_pulsation_passes_through_every_brightness():
    red = lit(Rig(), "pulsation", 400)
    assert (red.min(), red.max()) == (0, 200)
    assert np.abs(np.diff(red, axis=0)).max() < 5


def test_a_pattern_begins_when_it_is_commanded():
    rig = Rig()
    lit(rig, "dim", 37)
    assert lit(rig, "flash all", 1).all()


def test_current_and_temperature_follow_the_duty():
    idle, busy = Rig().step().sense(), Rig().duties(100, 100, -100, -100).step().sense()
    assert busy.y.current - idle.y.current == pytest.approx(6.0)
    start = busy.y.temperature
    busy.sensed(round(WARMING_S / 0.01))
    rise = busy.y.temperature - start
    assert rise == pytest.approx(2.5 * busy.y.current * (1 - np.exp(-1)), rel=1e-3)


def test_without_a_battery_there_is_no_current_but_a_temperature():
    rig = Rig(battery=Battery(enabled=False)).step().sense()
    assert rig.q.current == BAD_OUT_OF_SERVICE
    assert rig.q.temperature == GOOD
