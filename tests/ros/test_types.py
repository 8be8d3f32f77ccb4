"""Type hashes are those that ROS 2 announces; definitions and CDR are those of the world."""

import pytest
from rosbags.typesys import Stores, get_typestore

from hilserver.ros.flavours import FLAVOURS
from hilserver.ros.types import Types, known_types

PUBLIC = {
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "sensor_msgs/msg/Joy": "0d356c79cad3401e35ffeb75a96a96e08be3ef896b8b83841d73e890989372c5",
    "std_msgs/msg/Float32MultiArray": (
        "0599f6f85b4bfca379873a0b4375a0aca022156bd2d7021275d116ed1fa8bfe0"
    ),
    "std_srvs/srv/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
}
"""As stand in metadata of public bags and in listings of running systems."""


@pytest.mark.parametrize("name", PUBLIC)
def test_hashes_are_the_public_ones(name):
    assert known_types().hash(name) == f"RIHS01_{PUBLIC[name]}"


def test_hashes_of_messages_are_those_of_rosbags():
    store = get_typestore(Stores.ROS2_JAZZY)
    names = {topic.type for flavour in FLAVOURS.values() for topic in topics(flavour)}
    known = [name for name in names if name in store.fielddefs]
    assert len(known) > 8
    assert all(known_types().hash(name) == store.hash_rihs01(name) for name in known)


def topics(flavour):
    return (*flavour.published, *flavour.subscribed, *flavour.extras.values())


def test_every_type_of_every_flavour_has_a_hash():
    for flavour in FLAVOURS.values():
        for item in (*topics(flavour), *flavour.served):
            assert known_types().hash(item.type).startswith("RIHS01_")


def test_field_types_of_services_can_be_chosen():
    wide = Types({"SendLighting.command": "int32"})
    request = "iotbot_interface/srv/SendLighting_Request"
    message = wide.make(request, command=-1, red=1, green=2, blue=3)
    assert len(wide.encode(message)) == 4 + 4 + 3
    assert wide.decode(wide.encode(message), request) == message


@pytest.mark.parametrize(
    "widths", [{"SendLighting.colour": "int8"}, {"SendEnable.enable": "kg"}]
)
def test_what_cannot_be_chosen_is_refused(widths):
    with pytest.raises(ValueError, match=r"SendLighting\.colour|SendEnable"):
        Types(widths)


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0" + bytes(7)])
def test_bytes_that_are_no_message_are_refused(data):
    with pytest.raises(ValueError, match="no message of type geometry_msgs/msg/Twist"):
        known_types().decode(data, "geometry_msgs/msg/Twist")
