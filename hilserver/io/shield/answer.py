"""Writes a response from a frame of the process image, in compiled code."""

import math
from typing import Any, Final

from numba.core import types

from hilserver.compiled import inlined, kernel, part
from hilserver.io.shield.protocol import CHECKED_BYTES, crc8
from hilserver.plant.layout import CORNERS
from hilserver.plant.units import STANDARD_GRAVITY_M_S2
from hilserver.signals import SignalTable

ABSENT: Final = -1  # slot of a quantity that a planar robot does not have

(SPEEDS, RANGES, GYRO, ACCEL, ANGLES, VOLTAGE, CURRENT, TEMPERATURE, N_PLACES) = (
    0, 4, 8, 11, 14, 17, 18, 19, 20,
)  # fmt: skip


def places(table: SignalTable, wheels: tuple[str, ...], *, body: bool) -> list[int]:
    """Return the slots of the signals in a response, in the order of its fields."""
    imu = "mech.imu" if body else "imu"
    names = [f"wheel.{wheel}.speed_rpm" for wheel in wheels]
    names += [f"{'mech.' if body else ''}tof.{place}_m" for place in CORNERS]
    names += [f"{imu}.gyro_{axis}_rad_s" for axis in "xyz"]
    names += [f"{imu}.accel_{axis}_m_s2" for axis in "xyz"]
    attitude = ("mech.roll_rad", "mech.pitch_rad", "mech.yaw_rad")
    names += attitude if body else ("", "", "imu.yaw_rad")
    names += ["battery.voltage_v", "battery.current_a", "shield.temperature_degc"]
    return [table.slot(name) if name in table else ABSENT for name in names]


@inlined
def _put(out: Any, at: int, value: float, low: int, high: int) -> None:
    """Write `value` rounded and limited as two bytes; one that is not finite becomes 0."""
    whole = math.floor(value + 0.5) if math.isfinite(value) else 0
    whole = min(max(whole, low), high)
    out[at] = whole & 0xFF
    out[at + 1] = whole >> 8 & 0xFF


@part
def _signed(out: Any, at: int, value: float) -> None:
    _put(out, at, value, -32768, 32767)


@inlined
def _read(values: Any, slots: Any, place: int, otherwise: float) -> float:
    return otherwise if slots[place] < 0 else float(values[slots[place]])


@inlined
def _raw_imu(out: Any, values: Any, slots: Any) -> None:
    g = STANDARD_GRAVITY_M_S2
    degree = math.pi / 180.0
    _signed(out, 9, _read(values, slots, ACCEL + 2, g) / g * 1e4)
    _signed(out, 11, -_read(values, slots, ACCEL + 1, 0.0) / g * 1e4)
    _signed(out, 13, _read(values, slots, ACCEL, 0.0) / g * 1e4)
    _signed(out, 15, _read(values, slots, GYRO + 2, 0.0) / degree * 100.0)
    _signed(out, 17, -_read(values, slots, GYRO, 0.0) / degree * 100.0)
    _signed(out, 19, _read(values, slots, GYRO + 1, 0.0) / degree * 100.0)


@inlined
def _fused_imu(out: Any, values: Any, slots: Any) -> None:
    half_roll = 0.5 * _read(values, slots, ANGLES, 0.0)
    half_pitch = 0.5 * _read(values, slots, ANGLES + 1, 0.0)
    half_yaw = 0.5 * _read(values, slots, ANGLES + 2, 0.0)
    cr = math.cos(half_roll)
    sr = math.sin(half_roll)
    cp = math.cos(half_pitch)
    sp = math.sin(half_pitch)
    cy = math.cos(half_yaw)
    sy = math.sin(half_yaw)
    _signed(out, 9, (cr * cp * cy + sr * sp * sy) * 1e4)
    _signed(out, 11, (sr * cp * cy - cr * sp * sy) * 1e4)
    _signed(out, 13, (cr * sp * cy + sr * cp * sy) * 1e4)
    _signed(out, 15, (cr * cp * sy - sr * sp * cy) * 1e4)
    _signed(out, 17, _read(values, slots, TEMPERATURE, 0.0) * 100.0)
    out[19] = out[20] = 0


@kernel(types.int64(types.uint8[::1], types.int64, types.int64, types.int64,
                    types.float64[::1], types.int64[::1]))  # fmt: skip
def answer(out: Any, command: int, raw: int, crc: int, values: Any, slots: Any) -> int:
    """Write the response to `command` into `out`; return its length.

    Parameters
    ----------
    out : ndarray of uint8, shape (33,)
    raw : int
        1: raw values of the IMU, 0: quaternion and temperature.
    crc : int
        1: the variant ``crc``.
    values : ndarray of float64
        Values of a frame.
    slots : ndarray of int64, shape (N_PLACES,)
        See `places`.
    """
    out[0] = command
    for channel in range(4):
        _signed(out, 1 + 2 * channel, values[slots[SPEEDS + channel]] * 100.0)
        distance_mm = values[slots[RANGES + channel]] * 1000.0
        _put(out, 21 + 2 * channel, distance_mm, 0, 65535)
    if raw != 0:
        _raw_imu(out, values, slots)
    else:
        _fused_imu(out, values, slots)
    _put(out, 29, values[slots[VOLTAGE]] * 100.0, 0, 65535)
    if crc == 0:
        current = math.floor(values[slots[CURRENT]] * 20.0 + 0.5)
        out[31] = min(max(current, 0), 255)
        return 32
    temperature = math.floor(values[slots[TEMPERATURE]] + 0.5)
    out[31] = min(max(temperature, -128), 127) & 0xFF
    out[32] = crc8(out, 0, CHECKED_BYTES)
    return 33
