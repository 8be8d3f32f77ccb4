"""The battery's voltage at every tick."""

import numpy as np

from hilserver.diagnosis.replay.battery import voltage
from hilserver.measured.channels import VOLTAGE
from hilserver.measured.clock import cut
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span

PERIOD_S = 0.001


def test_the_simulations_battery_holds_its_voltage_from_the_tick_behind_its_sample():
    at = np.arange(0, 2001, 100)
    values = 20.0 - 0.01 * np.arange(len(at))
    channel = Channel(at * PERIOD_S, values, np.zeros(len(at), dtype=np.int64))
    spans = (Span(0, None, 0.0, 2.0),)
    log = MeasuredLog(
        (LogSource("run.mcap", "0" * 64),), {VOLTAGE: channel}, spans, on_ticks=True
    )
    segments = cut(log, PERIOD_S, None)
    volts = voltage(log, segments, np.zeros(segments.ticks))
    held = np.repeat(values, 100)
    assert volts[0] == values[0]
    np.testing.assert_array_equal(volts[1:2001], held[:2000])
