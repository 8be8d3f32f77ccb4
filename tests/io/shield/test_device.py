"""What requests do: inputs of the plant, stored parameters, faults."""

import math
import struct

import pytest

from hilserver.config.shield import ShieldConfig
from hilserver.core.refusal import Refusal
from hilserver.io.shield.device import Device
from hilserver.io.shield.protocol import Request, ShieldCommand
from hilserver.io.shield.status import ShieldStatus
from hilserver.io.source import Source


class Bench:
    def __init__(self, **config):
        self.status = ShieldStatus("shield")
        self.values, self.gains, self.refused = {}, [], {}
        self.told = []
        source = Source(
            ShieldConfig().driver,
            "shield",
            self.status,
            self,
            self.told.append,
            fresh=lambda: "fresh",
        )
        self.device = Device(
            ShieldConfig(**config), self.status, source, max_rpm=90.0, apply=self._apply
        )

    def write(self, source, values, *, received_ns, **_):
        assert source == "shield"
        self.values.update({k: v for k, v in values.items() if k not in self.refused})
        return {k: v for k, v in self.refused.items() if k in values}

    def _apply(self, k_p, k_i):
        if k_p > 100:
            raise ValueError("not stable")
        self.gains.append((k_p, k_i))

    def ask(self, command, payload=b"", **how):
        self.device.take(Request(command, payload.ljust(8, b"\0"), 1, **how))
        return self

    def rpm(self, *rpm):
        return self.ask(
            ShieldCommand.SET_RPM, struct.pack("<4h", *(round(100 * r) for r in rpm))
        )

    @property
    def setpoints(self):
        return [
            self.values.get(f"wheel.{wheel}.setpoint_rpm")
            for wheel in ("fl", "rl", "fr", "rr")
        ]


@pytest.fixture
def bench():
    return Bench().ask(ShieldCommand.ENABLE)


def test_speeds_go_to_the_wheels_of_the_channels(bench):
    assert bench.rpm(1, 2, 3, 4).setpoints == [4, 3, 2, 1]
    assert bench.values["control.mode"] == 0
    crc = Bench(variant="crc").ask(ShieldCommand.ENABLE)
    assert crc.rpm(1, 2, 3, 4).setpoints == [1, 3, 2, 4]
    own = Bench(channels=("rr", "fr", "fl", "rl")).ask(ShieldCommand.ENABLE)
    assert own.rpm(1, 2, 3, 4).setpoints == [3, 4, 2, 1]


def test_too_fast_is_scaled_together_and_named(bench):
    assert bench.rpm(180, 90, -45, 0).setpoints == [0, -22.5, 45, 90]
    assert bench.status.fault_counts["too_fast"] == 1


def test_nothing_moves_without_enable():
    bench = Bench().rpm(1, 2, 3, 4).ask(ShieldCommand.SET_PWM, b"\1\2\3\4")
    assert bench.values == {}
    assert bench.status.fault_counts["while_disabled"] == 2
    bench.rpm(0, 0, 0, 0)
    assert bench.status.fault_counts["while_disabled"] == 2


def test_disable_stops(bench):
    bench.rpm(1, 2, 3, 4).ask(ShieldCommand.DISABLE)
    assert (bench.values["drive.enable"], bench.setpoints) == (False, [0, 0, 0, 0])


def test_duties_pass_the_controller(bench):
    bench.ask(ShieldCommand.SET_PWM, struct.pack("<4b4x", 10, -20, 127, -128))
    assert bench.values["control.mode"] == 2
    duties = [
        bench.values[f"wheel.{wheel}.duty_command_pct"]
        for wheel in ("rr", "fr", "rl", "fl")
    ]
    assert duties == [10, -20, 100, -100]


def test_lights():
    bench = Bench().ask(ShieldCommand.LIGHTS_FLASH_LEFT, b"\x01\x02\x03")
    assert bench.values == {
        "lights.command": 4,
        "lights.red": 1,
        "lights.green": 2,
        "lights.blue": 3,
    }


def test_the_host_sets_how_long_it_may_be_silent(bench):
    bench.ask(ShieldCommand.UART_TIMEOUT, struct.pack("<f", 0.25))
    assert bench.device.limit_ns == 250_000_000
    for wrong in (0.0, -1.0, math.nan, math.inf):
        bench.ask(ShieldCommand.UART_TIMEOUT, struct.pack("<f", wrong))
    assert bench.device.limit_ns == 250_000_000


def test_parameters_are_stored_shown_and_counted_as_without_effect(bench):
    for command, number in (
        (ShieldCommand.KP, 0.5),
        (ShieldCommand.KI, 10.0),
        (ShieldCommand.GEAR_RATIO, 72.0),
    ):
        bench.ask(command, struct.pack("<f", number))
    bench.ask(ShieldCommand.AUX1, b"\xff").ask(ShieldCommand.IMU_CALIBRATE).ask(
        ShieldCommand.SYNC
    )
    assert bench.status.parameters == {
        "kp": 0.5,
        "ki": 10.0,
        "gear_ratio": 72.0,
        "aux1": 255.0,
    }
    assert bench.status.without_effect == 6
    assert not bench.gains
    assert "gear_ratio 72" in bench.status.figures["parameters"]


def test_parameters_are_applied_where_that_is_asked_for():
    bench = Bench(parameters="apply").ask(ShieldCommand.KP, struct.pack("<f", 0.5))
    bench.ask(ShieldCommand.KI, struct.pack("<f", 10.0))
    assert math.isnan(bench.gains[0][1])
    assert bench.gains[1] == (0.5, 10.0)
    bench.ask(ShieldCommand.KP, struct.pack("<f", 1e4))
    assert bench.status.fault_counts["bad_number"] == 1


def test_an_unknown_command_is_named():
    bench = Bench().ask(0x77)
    assert +bench.status.requests == {"unknown": 1}
    assert "0x77" in next(iter(bench.status.faults.values()))


def test_a_request_without_its_end_never_moves_the_robot(bench):
    bench.ask(
        ShieldCommand.SET_RPM, struct.pack("<4h", 1, 2, 3, 4), is_terminated=False
    )
    assert bench.setpoints == [0, 0, 0, 0]
    bench.ask(ShieldCommand.KP, struct.pack("<f", 0.5), is_terminated=False)
    assert bench.status.parameters == {"kp": 0.5}


def test_refusals_other_than_control_are_faults(bench):
    bench.refused = {"wheel.fl.setpoint_rpm": Refusal.NOT_IN_CONTROL}
    bench.rpm(1, 1, 1, 1)
    assert not +bench.status.fault_counts
    bench.refused = {"wheel.fl.setpoint_rpm": Refusal.OUT_OF_RANGE}
    bench.rpm(1, 1, 1, 1)
    assert bench.status.fault_counts["refused_value"] == 1
