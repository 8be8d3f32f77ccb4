"""The table of signals and the plant's arrays lie in the same order."""

import pytest

from hilserver.plant import layout
from hilserver.signals import State
from tests.fakes import make_table

BEGIN = {
    "wheel.fl.setpoint_rpm": layout.U_SETPOINT,
    "twist.linear_m_s": layout.U_TWIST_LINEAR,
    "twist.angular_rad_s": layout.U_TWIST_ANGULAR,
    "twist.lateral_m_s": layout.U_TWIST_LATERAL,
    "wheel.fl.duty_command_pct": layout.U_DUTY,
    "control.mode": layout.U_MODE,
    "drive.enable": layout.U_ENABLE,
    "lights.command": layout.U_LIGHTS,
    "input.sequence": layout.U_SEQUENCE,
    "internal.command": layout.U_COMMAND,
    "internal.pose_request": layout.U_POSE_REQUEST,
    "internal.pose_x_m": layout.U_POSE,
    "internal.gains": layout.U_GAINS,
    "wheel.fl.speed_rpm": layout.N_U + layout.Y_SPEED,
    "wheel.fl.duty_pct": layout.N_U + layout.Y_DUTY,
    "wheel.fl.angle_rad": layout.N_U + layout.Y_ANGLE,
    "pose.x_m": layout.N_U + layout.Y_POSE,
    "velocity.linear_m_s": layout.N_U + layout.Y_VELOCITY,
    "imu.gyro_z_rad_s": layout.N_U + layout.Y_IMU,
    "battery.voltage_v": layout.N_U + layout.Y_BATTERY,
    "tof.fl_m": layout.N_U + layout.Y_TOF,
    "nav.x_m": layout.N_U + layout.Y_NAV,
    "battery.current_a": layout.N_U + layout.Y_CURRENT,
    "shield.temperature_degc": layout.N_U + layout.Y_TEMPERATURE,
    "lights.state": layout.N_U + layout.Y_LIGHTS,
    "sim.tick": layout.N_U + layout.N_Y,
}
"""First signal of each group in the plant's arrays; the last one: nothing lies between."""


@pytest.mark.parametrize(("name", "place"), BEGIN.items())
def test_a_signal_lies_where_the_plant_computes_it(name, place):
    assert make_table().slot(name) == place


def test_wheels_stand_in_the_order_of_the_plant():
    table = make_table()
    for quantity, first in (("setpoint_rpm", 0), ("speed_rpm", layout.N_U)):
        slots = [table.slot(f"wheel.{wheel}.{quantity}") for wheel in layout.WHEELS]
        assert slots == list(range(first, first + layout.N_WHEELS))


def test_values_with_names_have_one_for_each():
    for signal in make_table():
        if signal.labels:
            assert len(signal.labels) == signal.high + 1
    assert make_table()["sim.state"].labels == tuple(state.word for state in State)
