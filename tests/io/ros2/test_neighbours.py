"""What is known of other programs: the domains that they are in, and what does not fit."""

from types import SimpleNamespace

import pytest

from hilserver.io.ros2.neighbours import Neighbours, RemoteEndpoint, other_domains
from hilserver.io.ros2.participant import In, Out, TopicInfo
from hilserver.ros.qos import DEFAULT, LATCHED, SENSOR_DATA

HEAD = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid\n"


def listed(tmp_path, *ports):
    file = tmp_path / "udp"
    lines = (
        f"  0: 00000000:{port:04X} 00000000:0000 07 00000000:00000000\n"
        for port in ports
    )
    file.write_text(HEAD + "".join(lines), encoding="ascii")
    return file


def test_ports_tell_the_domains_of_others(tmp_path):
    ports = (7400, 7410, 7411, 7400 + 250 * 42 + 12, 7400 + 250 * 87 + 10, 5353, 53)
    assert other_domains(87, listed(tmp_path, *ports)) == [0, 42]


def test_ports_that_any_program_may_get_tell_nothing(tmp_path):
    assert other_domains(0, listed(tmp_path, 7400 + 250 * 120 + 10, 7401)) == []


def test_the_system_s_own_list_can_be_read():
    assert isinstance(other_domains(0), list)


IMU, DESCRIPTION = "sensor_msgs::msg::dds_::Imu_", "std_msgs::msg::dds_::String_"


def endpoint(kind, topic, type_name, qos):
    made = kind.__new__(kind)
    made.subject = TopicInfo(topic, type_name, "", qos)
    return made


@pytest.mark.parametrize(
    ("ours", "is_reliable", "is_latched", "says"),
    [
        (
            endpoint(Out, "rt/imu", IMU, SENSOR_DATA),
            *(True, False),
            "no data flows on /imu: a participant that has left asks for RELIABLE, the robot offers"
            " BEST_EFFORT; let a participant that has left read /imu BEST_EFFORT",
        ),
        (
            endpoint(In, "rt/imu", IMU, LATCHED),
            *(True, False),
            "no data flows on /imu: the robot asks for TRANSIENT_LOCAL, a participant that has left"
            " offers VOLATILE; let a participant that has left write /imu TRANSIENT_LOCAL",
        ),
        (endpoint(Out, "rt/imu", IMU, SENSOR_DATA), False, False, None),
        (endpoint(Out, "rt/imu", IMU, DEFAULT), True, False, None),
        (endpoint(Out, "rt/imu", DESCRIPTION, SENSOR_DATA), True, False, None),
    ],
)
def test_a_quality_of_service_that_does_not_fit_is_said_with_its_remedy(
    ours, is_reliable, is_latched, says
):
    nobody = SimpleNamespace(discovered=lambda _: None)
    other = RemoteEndpoint("rt/imu", IMU, "", is_reliable, is_latched, b"", b"", 0)
    neighbours = Neighbours(nobody, readers={1: other}, writers={1: other})
    for _ in range(2):  # for as long as it is so
        found = dict(neighbours.incompatible([ours]))
        assert list(found.values()) == ([] if says is None else [says])
