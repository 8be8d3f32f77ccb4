"""The daemon's place in the graph of ROS 2: what ``ros2 node list`` and ``ros2 node info`` show."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from hilserver.io.ros2.participant import In, Out, Participant
from hilserver.io.ros2.wire import WireTypes
from hilserver.ros.qos import LATCHED
from hilserver.ros.types import GID, Types

TOPIC: Final = "ros_discovery_info"
ENTITIES, NODE = (
    "rmw_dds_common/msg/ParticipantEntitiesInfo",
    "rmw_dds_common/msg/NodeEntitiesInfo",
)


def announce(
    participant: Participant,
    types: Types,
    wire: WireTypes,
    name: tuple[str, str],
    ours: Sequence[In | Out],
) -> Out:
    """Tell every node, also later ones, which endpoints are those of one node.

    Parameters
    ----------
    name : tuple of str
        Namespace (``/`` is the root) and name of the node.

    Returns
    -------
    Out
        The writer, which has to be kept for as long as the node is there.
    """

    def gid(number: bytes) -> Any:
        return types.make(GID, data=np.frombuffer(number, dtype=np.uint8))

    space, short = name
    node = types.make(
        NODE,
        node_namespace=space,
        node_name=short,
        reader_gid_seq=[gid(one.gid) for one in ours if isinstance(one, In)],
        writer_gid_seq=[gid(one.gid) for one in ours if isinstance(one, Out)],
    )
    entities = types.make(
        ENTITIES, gid=gid(participant.gid), node_entities_info_seq=[node]
    )
    writer = participant.writer(
        TOPIC, wire.make(ENTITIES), LATCHED, types.hash(ENTITIES)
    )
    writer.write(types.encode(entities))
    return writer
