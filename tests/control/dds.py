"""A message of the robot's ROS 2 program, as another DDS program declares it."""

from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float32

LOOPBACK = """<CycloneDDS><Domain Id="any"><General><Interfaces>
<NetworkInterface name="lo" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery>
<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""


@dataclass
class RotationSpeed(IdlStruct, typename="iotbot_interface::msg::dds_::RotationSpeed_"):
    front_left_rpm: float32
    front_right_rpm: float32
    rear_left_rpm: float32
    rear_right_rpm: float32
