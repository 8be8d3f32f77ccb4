"""Sentences: what was probably meant by a name, why an address cannot be used."""

import errno
import socket

import pytest

from hilserver.errors import address_refused, meant, nearest

SIGNALS = ["segment", "wheel.fl.setpoint_rpm", "wheel.fl.speed_rpm", "imu.gyro_z_rad_s"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("wheel.fl.setpoint_rmp", "wheel.fl.setpoint_rpm"),
        ("speed", "wheel.fl.speed_rpm"),
        ("Gyro", "imu.gyro_z_rad_s"),
        ("segmnt", "segment"),
        ("x", None),
        ("", None),
    ],
)
def test_the_name_spelt_alike_or_the_first_that_holds_it(name, expected):
    assert nearest(name, SIGNALS) == expected


def test_where_nothing_is_near_the_way_on_is_told():
    assert meant("prot", ["host", "endpoint"], "known are host, endpoint") == (
        "known are host, endpoint"
    )
    assert meant("prt", ["host", "port"], "nothing") == "did you mean 'port'?"


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (
            OSError(errno.EADDRINUSE, "bind: [::1]:1"),
            "address already in use); end the program",
        ),
        (
            socket.gaierror(socket.EAI_NONAME, "Name or service not known"),
            "name or service not known); check the address",
        ),
        (OSError("the door is shut"), "the door is shut); check the address"),
    ],
)
def test_an_address_is_refused_in_words_without_numbers(error, why):
    assert str(address_refused("s7: cannot listen", error)).startswith(
        f"s7: cannot listen ({why}"
    )
