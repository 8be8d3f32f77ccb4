"""Requests, responses and the check sum: pure functions."""

import math
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.config.shield import CHANNELS
from hilserver.io.shield.answer import answer, places
from hilserver.io.shield.protocol import (
    BYTE_NS,
    RESPONSE_BYTES,
    Request,
    ShieldCommand,
    crc8,
    request,
)
from tests.fakes import make_table

TABLE = make_table()


def shown(variant="iotbot", raw=1, command=0x11, **values):
    """Return the response to a frame that holds `values`; dots are written as two underscores."""
    frame = np.zeros(TABLE.n_slots)
    for name, value in values.items():
        frame[TABLE.slot(name.replace("__", "."))] = value
    slots = np.array(places(TABLE, CHANNELS[variant], body=False), dtype=np.int64)
    out = np.zeros(33, dtype=np.uint8)
    length = answer(out, command, raw, variant == "crc", frame, slots)
    assert length == RESPONSE_BYTES[variant]
    return bytes(out[:length])


def response(data):
    """Take a response of the variant ``iotbot`` apart; raw or fused, only the host knows."""
    az, ay, ax, gz, gx, gy = struct.unpack_from("<6h", data, 9)
    return SimpleNamespace(
        command=data[0],
        speeds_rpm=tuple(v / 100 for v in struct.unpack_from("<4h", data, 1)),
        accel_g=(ax / 1e4, -ay / 1e4, az / 1e4),
        gyro_deg_s=(-gx / 100, gy / 100, gz / 100),
        quaternion=tuple(v / 1e4 for v in struct.unpack_from("<4h", data, 9)),
        fused_degc=struct.unpack_from("<h", data, 17)[0] / 100,
        ranges_m=tuple(v / 1000 for v in struct.unpack_from("<4H", data, 21)),
        voltage_v=struct.unpack_from("<H", data, 29)[0] / 100,
        current_a=data[31] / 20,
        temperature_degc=struct.unpack_from("<b", data, 31)[0],
    )


def test_a_request_as_the_drivers_write_it():
    rpm = struct.pack("<4h", 1000, -1000, 1, -1)
    assert request(ShieldCommand.SET_RPM, rpm) == bytes.fromhex(
        "ff11e80318fc0100ffffee"
    )
    assert request(ShieldCommand.ENABLE) == bytes.fromhex("ff010000000000000000ee")


def test_check_sum_is_that_of_the_catalogue():
    # CRC-8/SMBUS of the catalogue of CRC algorithms
    assert crc8(b"123456789", 0, 9) == 0xF4


def test_check_sum_covers_only_eight_bytes():
    one, other = (
        request(ShieldCommand.SET_RPM, bytes((1, 2, 3, 4, 5, 6, x)), "crc")
        for x in (0, 99)
    )
    assert one[10] == other[10] == crc8(one, 0, 8)


def test_payloads():
    floats = Request(ShieldCommand.KP, struct.pack("<fI", 0.5, 0))
    assert (floats.name, floats.number) == ("kp", 0.5)
    assert Request(
        ShieldCommand.SET_RPM, struct.pack("<4h", 1, -2, 3, -4)
    ).speeds_rpm == (
        0.01,
        -0.02,
        0.03,
        -0.04,
    )
    assert Request(
        ShieldCommand.SET_PWM, struct.pack("<4b4x", 1, -2, 127, -128)
    ).duties_pct == (
        1,
        -2,
        127,
        -128,
    )
    assert Request(0x77, bytes(8)).name == "unknown"


def test_speeds_stand_by_channel():
    speeds = {
        "wheel__rr__speed_rpm": 1,
        "wheel__fr__speed_rpm": 2,
        "wheel__rl__speed_rpm": 3,
    }
    speeds["wheel__fl__speed_rpm"] = -4.005
    assert response(shown(**speeds)).speeds_rpm == (1, 2, 3, -4.0)
    assert response(shown("crc", **speeds)).speeds_rpm == (-4.0, 2, 3, 1)


def test_raw_imu_has_the_axes_that_the_driver_maps_back():
    data = shown(
        imu__accel_x_m_s2=0.980665, imu__accel_y_m_s2=-1.96133, imu__gyro_z_rad_s=0.5
    )
    said = response(data)
    assert said.accel_g == pytest.approx((0.1, -0.2, 1.0))
    assert said.gyro_deg_s == pytest.approx((0.0, 0.0, math.degrees(0.5)), abs=0.005)


def test_fused_imu_is_a_quaternion_and_a_temperature():
    said = response(shown(raw=0, imu__yaw_rad=1.0, shield__temperature_degc=31.4))
    assert said.quaternion == pytest.approx(
        (math.cos(0.5), 0, 0, math.sin(0.5)), abs=5e-5
    )
    assert said.fused_degc == pytest.approx(31.4)


def test_ranges_voltage_current():
    said = response(
        shown(
            tof__fl_m=0.1,
            tof__fr_m=0.2,
            tof__rl_m=0.3,
            tof__rr_m=5.0,
            battery__voltage_v=19.2,
        )
    )
    assert (said.ranges_m, said.voltage_v) == ((0.1, 0.2, 0.3, 5.0), 19.2)
    assert response(shown(battery__current_a=1.5)).current_a == 1.5
    assert response(shown(battery__current_a=99)).current_a == 255 / 20


def test_the_variant_crc_ends_with_temperature_and_check_sum():
    data = shown("crc", shield__temperature_degc=-3.6, battery__current_a=5)
    assert struct.unpack_from("<b", data, 31) == (-4,)
    assert data[32] == crc8(data, 0, 8)


@given(
    st.floats(allow_nan=True, allow_infinity=True), st.integers(0, 255), st.booleans()
)
def test_any_value_fits_into_its_field(value, command, crc):
    names = (
        "wheel__fl__speed_rpm",
        "imu__gyro_z_rad_s",
        "imu__accel_x_m_s2",
        "tof__rl_m",
    )
    data = shown(
        "crc" if crc else "iotbot", command=command, **dict.fromkeys(names, value)
    )
    assert data[0] == command
    if math.isnan(value):
        assert response(data).speeds_rpm == (0, 0, 0, 0)


def test_a_byte_on_the_line_is_never_too_short():
    assert 10 / 115200 < BYTE_NS * 1e-9 < 10 / 115200 + 2e-9
