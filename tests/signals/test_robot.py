"""The table of signals and the plant's arrays lie in the same order."""

import pytest

from hilserver.plant.layout import N_WHEELS, WHEELS, Inputs, Outputs
from hilserver.signals import State
from tests.fakes import make_table

N_U = Inputs.n_words
BEGIN = {
    "wheel.fl.setpoint_rpm": ("u", "setpoint"),
    "twist.linear_m_s": ("u", "twist_linear"),
    "twist.angular_rad_s": ("u", "twist_angular"),
    "twist.lateral_m_s": ("u", "twist_lateral"),
    "wheel.fl.duty_command_pct": ("u", "duty"),
    "control.mode": ("u", "mode"),
    "drive.enable": ("u", "enable"),
    "lights.command": ("u", "light_pattern"),
    "input.sequence": ("u", "sequence"),
    "internal.command": ("u", "command"),
    "internal.pose_request": ("u", "pose_request"),
    "internal.pose_x_m": ("u", "pose"),
    "internal.gains": ("u", "own_gains"),
    "wheel.fl.speed_rpm": ("y", "speed"),
    "wheel.fl.duty_pct": ("y", "duty"),
    "wheel.fl.angle_rad": ("y", "angle"),
    "pose.x_m": ("y", "pose"),
    "velocity.linear_m_s": ("y", "linear"),
    "imu.gyro_z_rad_s": ("y", "gyro"),
    "battery.voltage_v": ("y", "battery"),
    "tof.fl_m": ("y", "tof"),
    "nav.x_m": ("y", "nav"),
    "battery.current_a": ("y", "current"),
    "shield.temperature_degc": ("y", "temperature"),
    "lights.state": ("y", "light_pattern"),
    "wheel.fl.demand_rpm": ("y", "demand"),
}
"""First signal of each group, and where the plant has it: inputs `u`, outputs `y`."""


@pytest.mark.parametrize(("name", "place"), BEGIN.items())
def test_a_signal_lies_where_the_plant_computes_it(name, place):
    record, field = place
    first = (
        Inputs.where(field).start if record == "u" else N_U + Outputs.where(field).start
    )
    assert make_table().slot(name) == first


def test_nothing_lies_between_outputs_and_what_follows_them():
    assert make_table().slot("sim.tick") == N_U + Outputs.n_words


def test_wheels_stand_in_the_order_of_the_plant():
    table = make_table()
    for quantity, first in (
        ("setpoint_rpm", 0),
        ("speed_rpm", N_U),
        ("demand_rpm", N_U + Outputs.where("demand").start),
    ):
        slots = [table.slot(f"wheel.{wheel}.{quantity}") for wheel in WHEELS]
        assert slots == list(range(first, first + N_WHEELS))


def test_values_with_names_have_one_for_each():
    for signal in make_table():
        if signal.labels:
            assert len(signal.labels) == signal.high + 1
    assert make_table()["sim.state"].labels == tuple(state.word for state in State)
