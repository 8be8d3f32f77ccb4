"""What a client finds when it browses."""

import re
from pathlib import Path

import pytest
from asyncua import ua

import hilserver
from hilserver.errors import ConfigError
from hilserver.io.opcua_server.application import STATUS_OF
from hilserver.io.opcua_server.method_table import METHODS
from hilserver.io.opcua_server.model import DI_NAMESPACE_URI, GROUPS, describe
from hilserver.io.opcua_server.robot_events import TYPE_NAMES
from hilserver.io.opcua_server.units import UNECE
from hilserver.signals import Signal, SignalTable
from tests.io.opcua_server.rig import TABLE, Rig, RobotClient

pytestmark = pytest.mark.asyncio(loop_scope="module")
A = ua.AttributeIds


async def attributes(client: RobotClient, path: str, *ids: ua.AttributeIds) -> list:
    return [value.Value.Value for value in await client.path(path).read_attributes(ids)]


async def properties(client: RobotClient, path: str) -> dict:
    nodes = await client.path(path).get_properties()
    return {(await n.read_browse_name()).Name: await n.read_value() for n in nodes}


async def test_robot_is_found_from_objects_by_way_of_di(client: RobotClient) -> None:
    di = await client.get_namespace_index(DI_NAMESPACE_URI)
    path = [
        f"{di}:DeviceSet",
        f"{client.index}:Robot",
        f"{client.index}:pose",
        f"{client.index}:x_m",
    ]
    node = await client.nodes.objects.get_child(path)
    assert node.nodeid == ua.NodeId("pose.x_m", client.index)
    device_set = await client.nodes.objects.get_child(path[:1])
    assert device_set.nodeid == ua.NodeId(5001, di)


async def test_the_robot_has_a_nameplate_where_asset_tools_look(
    client: RobotClient,
) -> None:
    di = await client.get_namespace_index(DI_NAMESPACE_URI)
    robot = client.path("robot")
    found = {}
    for node in await robot.get_properties():
        name = await node.read_browse_name()
        assert name.NamespaceIndex == di
        value = await node.read_data_value()
        assert value.Value.VariantType.value == (await node.read_data_type()).Identifier
        found[name.Name] = getattr(value.Value.Value, "Text", value.Value.Value)
    assert found["Manufacturer"] == "hilserver"
    assert found["SoftwareRevision"] == hilserver.__version__
    assert re.fullmatch("[0-9a-f]{12}", found["SerialNumber"])
    assert found["ProductInstanceUri"].endswith(found["SerialNumber"])
    mandatory = {
        "Manufacturer",
        "Model",
        "HardwareRevision",
        "SoftwareRevision",
        "DeviceRevision",
    }
    mandatory |= {"DeviceManual", "SerialNumber", "RevisionCounter"}
    assert found.keys() >= mandatory
    group = await robot.get_child(f"{di}:Identification")
    members = await group.get_referenced_nodes(ua.ObjectIds.Organizes)
    assert {(await node.read_browse_name()).Name for node in members} == found.keys()


async def test_namespaces_have_fixed_order(client: RobotClient) -> None:
    uris = await client.get_namespace_array()
    assert uris[2:] == ["urn:hilserver:robot", DI_NAMESPACE_URI]


async def test_our_namespaces_are_described_where_clients_look(
    client: RobotClient,
) -> None:
    found = {}
    for node in await client.get_node(
        ua.NodeId(ua.ObjectIds.Server_Namespaces)
    ).get_children():
        properties = await node.get_properties()
        values = {
            (await p.read_browse_name()).Name: await p.read_value() for p in properties
        }
        assert values["NamespaceUri"] == (await node.read_browse_name()).Name
        found[values["NamespaceUri"]] = values
    ours, di = found["urn:hilserver:robot"], found[DI_NAMESPACE_URI]
    assert ours["NamespaceVersion"] == hilserver.__version__
    assert (ours["IsNamespaceSubset"], di["IsNamespaceSubset"]) == (False, True)
    assert (ours["StaticNodeIdTypes"], di["StaticNodeIdTypes"]) == ([1], [0])


async def test_every_signal_is_a_variable_of_its_type(client: RobotClient) -> None:
    for signal in TABLE:
        name, data_type, rank, dims, access, description = await attributes(
            client, signal.name, A.BrowseName, A.DataType, A.ValueRank, A.ArrayDimensions,
            A.AccessLevel, A.Description,
        )  # fmt: skip
        assert name.Name == signal.name.rpartition(".")[2]
        assert ua.VariantType(data_type.Identifier).name == signal.type.value
        assert (rank, dims) == (
            (1, [len(signal.slots)]) if signal.is_array else (-1, None)
        )
        assert access == (3 if signal.writable else 1), signal.name
        assert description.Text == signal.description


async def test_analog_variables_have_range_and_unit(client: RobotClient) -> None:
    for name in ("wheel.fl.setpoint_rpm", "wheels.speeds_rpm", "imu.accel_x_m_s2"):
        signal = TABLE[name]
        kind = await client.path(name).read_type_definition()
        assert kind == ua.NodeId(ua.ObjectIds.AnalogUnitRangeType)
        found = await properties(client, name)
        assert (found["EURange"].Low, found["EURange"].High) == (
            signal.low,
            signal.high,
        )
        assert found["EngineeringUnits"].UnitId == UNECE[signal.unit].unit_id
        assert found["EngineeringUnits"].DisplayName.Text == signal.unit


async def test_enumerations_name_their_values(client: RobotClient) -> None:
    kind = await client.path("sim.state").read_type_definition()
    assert kind == ua.NodeId(ua.ObjectIds.MultiStateDiscreteType)
    states = (await properties(client, "sim.state"))["EnumStrings"]
    assert [text.Text for text in states] == [
        "starting",
        "running",
        "paused",
        "safe",
        "stopping",
    ]
    lights = (await properties(client, "lights.command"))["EnumStrings"]
    assert len(lights) == TABLE["lights.command"].high + 1
    enable = await properties(client, "drive.enable")
    assert enable["TrueState"].Text == "enabled"


async def test_folders_are_small_and_lead_to_every_signal(client: RobotClient) -> None:
    found: set[str] = set()
    folders = ["robot"]
    while folders:
        children = await client.path(folders.pop()).get_children()
        assert len(children) < 1000
        for child in children:
            if await child.read_node_class() == ua.NodeClass.Variable:
                found.add(child.nodeid.Identifier)
            elif await child.read_node_class() == ua.NodeClass.Object:
                folders.append(child.nodeid.Identifier)
    assert {signal.name for signal in TABLE} | {"control.source"} <= found


async def test_hidden_signals_are_not_shown(client: RobotClient) -> None:
    value = await client.data_value("internal.command")
    assert value.StatusCode.name == "BadNodeIdUnknown"


async def test_methods_describe_their_arguments(client: RobotClient) -> None:
    for method in METHODS:
        node = client.path(method.node_id)
        found = {
            (await n.read_browse_name()).Name: n for n in await node.get_properties()
        }
        arguments = await found["InputArguments"].read_value() if found else []
        described = [
            (a.Name, ua.VariantType(a.DataType.Identifier).name, a.Description.Text)
            for a in arguments
        ]
        assert described == [
            (a.name, str(a.type), a.description) for a in method.arguments
        ]


async def test_build_info_and_uris(client: RobotClient, rig: Rig) -> None:
    info = await client.get_node(
        ua.ObjectIds.Server_ServerStatus_BuildInfo
    ).read_value()
    assert (info.ProductName, info.SoftwareVersion[:2]) == ("hilserver", "0.")
    endpoint = (await client.get_endpoints())[0]
    assert endpoint.Server.ApplicationUri.endswith(":hilserver")
    assert endpoint.EndpointUrl == rig.server.url


async def test_reference_page_names_everything() -> None:
    page = (
        Path(__file__).parents[3] / "docs/reference/opcua-address-space.md"
    ).read_text()
    codes = {ua.StatusCode(code).name for code in STATUS_OF.values()}
    for word in (*(m.name for m in METHODS), *TYPE_NAMES.values(), *GROUPS, *codes):
        assert word in page, word


async def test_a_signal_cannot_take_a_reserved_place() -> None:
    first = next(iter(TABLE))
    for name in ("methods.x", "wheel", "robot"):
        odd = Signal(name, "1", first.type, first.direction, 0, 1, "", (1,))
        with pytest.raises(ConfigError, match="cannot be called"):
            describe(SignalTable([first, odd]))
