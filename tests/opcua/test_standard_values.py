"""No standard variable of the server waits for initial data for ever."""

import pytest
from asyncua import ua

from hilserver.opcua import standard_values
from tests.io.opcua_server.rig import Rig, RobotClient

pytestmark = pytest.mark.asyncio(loop_scope="module")


async def test_every_standard_variable_below_objects_has_a_value(
    rig: Rig, client: RobotClient
) -> None:
    space = rig.server._server.iserver.aspace
    node_ids = [node_id for node_id, _ in standard_values._variables(space)]
    assert len(node_ids) > 250
    found = {}
    for first in range(0, len(node_ids), 500):
        some = node_ids[first : first + 500]
        values = await client.uaclient.read_attributes(some, ua.AttributeIds.Value)
        found |= {
            node_id: value.StatusCode.name
            for node_id, value in zip(some, values, strict=True)
        }
    assert {node_id: code for node_id, code in found.items() if code != "Good"} == {}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ServerCapabilities_ServerProfileArray", []),
        ("ServerCapabilities_LocaleIdArray", ["en"]),
        ("ServerCapabilities_MaxSessions", 100),
        ("ServerCapabilities_MaxBrowseContinuationPoints", 20),
        ("ServerCapabilities_OperationLimits_MaxNodesPerBrowse", 1000),
        ("ServerCapabilities_MinSupportedSampleRate", 5.0),
        ("Auditing", False),
        ("ServerDiagnostics_EnabledFlag", False),
        ("ServerRedundancy_RedundancySupport", 0),
    ],
)
async def test_what_clients_look_at_first(
    client: RobotClient, name: str, value: object
) -> None:
    node_id = ua.NodeId(getattr(ua.ObjectIds, f"Server_{name}"))
    assert await client.get_node(node_id).read_value() == value
