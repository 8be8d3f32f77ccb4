"""Two gear motors under a controller whose loop was slowed down (recording `motor_micromouse`)."""

import json

import numpy as np
import pytest

from hilserver.commands import main
from hilserver.identify.dead_zone import identify_dead_zone
from hilserver.identify.estimates import blocks_of, regress
from hilserver.identify.update_rate import compare, identify_update_rate
from hilserver.measured.reading import read_measured
from tests.helpers.recordings import recording

PWM_FULL = 255
STEPS = f"""
time: {{column: time, unit: ms}}
channels:
  wheel.fl.setpoint_rpm: {{column: targetSpeed}}
  wheel.fl.speed_rpm: {{column: leftSpeed}}
  wheel.fl.duty_pct: {{column: leftCommand, unit: "1", scale: {100 / PWM_FULL}}}
  wheel.fr.setpoint_rpm: {{column: targetSpeed, sign: -1}}
  wheel.fr.speed_rpm: {{column: rightSpeed, sign: -1}}
  wheel.fr.duty_pct: {{column: rightCommand, unit: "1", sign: -1, scale: {100 / PWM_FULL}}}
"""
SWEEP = f"""
time: {{column: time, unit: UNIT}}
channels:
  battery.voltage_v: {{column: batteryVoltage, unit: "1", scale: 0.001}}
  wheel.fl.duty_pct: {{column: motorCommand, unit: "1", scale: {100 / PWM_FULL}}}
  wheel.fl.speed_rpm: {{column: leftSpeedRpm}}
  wheel.fr.duty_pct: {{column: motorCommand, unit: "1", sign: -1, scale: {100 / PWM_FULL}}}
  wheel.fr.speed_rpm: {{column: rightSpeedRpm, sign: -1}}
"""
INJECTED_MS = (1, 2, 5, 10)


@pytest.fixture
def folder():
    return recording("motor_micromouse")


@pytest.fixture
def mapping(tmp_path):
    path = tmp_path / "steps.yaml"
    path.write_text(STEPS)
    return path


def log_of(folder, ms):
    return folder / f"controllerDelayImpact{ms}ms.csv"


def test_update_rates_come_out_in_the_right_order(folder, mapping):
    rates = {
        ms: identify_update_rate(read_measured([log_of(folder, ms)], mapping))
        for ms in reversed(INJECTED_MS)
    }
    pairs = compare(list(rates.values()))
    order = [pairs[0].faster, *(pair.slower for pair in pairs)]
    assert order == [log_of(folder, ms).name for ms in INJECTED_MS]
    assert [pair.distinguishable for pair in pairs] == [False, True, True]
    assert rates[5].period_s.value == pytest.approx(0.006, abs=0.0003)
    assert rates[10].period_s.value == pytest.approx(0.011, abs=0.0003)


@pytest.mark.parametrize(("ms", "left_ms"), [(1, 91), (2, 84), (5, 150), (10, 231)])
def test_rise_to_63_percent(folder, mapping, ms, left_ms):
    left, right = identify_update_rate(
        read_measured([log_of(folder, ms)], mapping)
    ).rises
    assert left.rise_s.value == pytest.approx(left_ms * 1e-3, abs=0.004)
    assert right.rise_s.value < left.rise_s.value
    assert left.rise_s.ci95[0] <= left.rise_s.value <= left.rise_s.ci95[1]


def test_command_says_that_1_and_2_ms_cannot_be_told_apart(folder, mapping, capsys):
    words = ["identify", "update-rate", "--mapping", str(mapping)]
    assert main([*words, *(str(log_of(folder, ms)) for ms in INJECTED_MS)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum("not distinguishable from" in line for line in lines) == 1
    assert sum("is faster than" in line for line in lines) == 2
    assert main([*words, "--json", str(log_of(folder, 5))]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["logs"][0]["period_s"]["ci95"][1] < 0.0065


@pytest.mark.parametrize(("file", "unit", "step"), [(3, "ms", 1), (5, "s", 5)])
def test_dead_zone_of_the_left_motor(folder, tmp_path, file, unit, step):
    path = tmp_path / "sweep.yaml"
    path.write_text(SWEEP.replace("UNIT", unit))
    log = read_measured([folder / f"wheelSpeedCalibration{file}.csv"], path)
    left = identify_dead_zone(log)[0]
    lower, upper = (
        zone.value * PWM_FULL / 100 for zone in (left.lower_pct, left.upper_pct)
    )
    assert lower == pytest.approx(-39, abs=step)
    assert upper == pytest.approx(65, abs=step)


def test_battery_sags_while_the_motor_starts(folder):
    table = np.genfromtxt(folder / "batteryVoltage3.csv", delimiter=",", skip_header=1)
    t_s, volts, starting = table[:, 0] * 1e-3, table[:, 1] * 1e-3, table[:, 2] != 0.0
    block = blocks_of(t_s, starting.astype(np.int64) * -1, 0.1)
    found = regress(np.stack([np.ones(len(t_s)), starting], axis=1), volts, block)
    sag = found.estimate(1, "V")
    assert sag.ci95[1] < 0.0
    assert sag.value == pytest.approx(-0.21, abs=0.06)
