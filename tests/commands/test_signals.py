"""`hilserver signals` in its four formats."""

import csv
import io
from pathlib import Path

import pytest
from asyncua import Server, ua

from hilserver.commands import main
from hilserver.commands.signals import COLUMNS, as_csv
from hilserver.daemon.assembly import assemble
from hilserver.errors import EXIT_BAD_CONFIGURATION
from hilserver.io.opcua_server.address_space import AddressSpaceBuilder
from hilserver.io.opcua_server.method_table import METHODS
from hilserver.io.opcua_server.model import DI_NAMESPACE_URI, NAMESPACE_URI, describe
from hilserver.io.opcua_server.nodeset import to_nodeset
from hilserver.io.opcua_server.units import UNECE
from hilserver.parameters import PLANT

REFERENCE = Path(__file__).parents[2] / "docs" / "reference" / "signals.md"


@pytest.fixture(scope="module")
def table():
    return assemble(None).table


def test_csv_has_every_signal_once(table) -> None:
    rows = list(csv.DictReader(io.StringIO(as_csv(table))))
    assert tuple(rows[0]) == COLUMNS
    assert [row["signal"] for row in rows] == [signal.name for signal in table]
    by_name = {row["signal"]: row for row in rows}
    assert by_name["wheels.setpoints_rpm"]["type"] == "Double[4]"
    assert by_name["wheel.fl.speed_rpm"]["unece"] == "RPM"
    assert by_name["input.sequence"]["high"] == "4.29497e+09"


def test_command_prints_and_writes(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["signals", "--format", "csv"]) == 0
    assert capsys.readouterr().out.startswith("signal,type,unit")
    assert main(["signals", "--format", "nodeset2", "-o", "x.xml"]) == 0
    assert (tmp_path / "x.xml").read_text(encoding="utf-8").startswith("<?xml")
    assert main(["signals", "-o", "no/such/folder/x.md"]) == 1
    assert "cannot write" in capsys.readouterr().err


S7 = """
s7:
  server: {port: 1102, blocks: {7: [{signal: sim.tick, at: 0, type: UDINT},
                                    {signal: drive.enable, at: 4.1, type: BOOL}]}}
peers:
  - {name: plc, endpoint: s7://192.0.2.20/0/1, read: {"DB1,REAL4": wheel.fl.setpoint_rpm}}
"""


def test_scl_prints_the_data_blocks_of_the_configuration(tmp_path, capsys) -> None:
    path, out = tmp_path / "config.yaml", tmp_path / "blocks.scl"
    path.write_text(S7, encoding="utf-8")
    words = ["signals", "--format", "scl", "-c", str(path)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert [line for line in printed.splitlines() if line.startswith("DATA_BLOCK")] == [
        'DATA_BLOCK "hilserver_DB7"',
        'DATA_BLOCK "plc_DB1"',
    ]
    assert main([*words, "-o", str(out)]) == 0
    assert out.read_text(encoding="utf-8") == printed
    path.write_text("", encoding="utf-8")
    assert main(words) == EXIT_BAD_CONFIGURATION
    assert (
        "has no data block: add s7.server, or a peer at s7://"
        in capsys.readouterr().err
    )


async def test_nodeset_is_the_address_space_of_the_server(table) -> None:
    loaded, built = Server(), Server()
    for server in (loaded, built):
        await server.init()
        await server.register_namespace(NAMESPACE_URI)
    await loaded.import_xml(xmlstring=to_nodeset(table, PLANT.values()))

    di_index = await built.register_namespace(DI_NAMESPACE_URI)
    builder = AddressSpaceBuilder(built.iserver.node_mgt_service, 2, di_index)
    folders, variables = describe(table, PLANT.values())
    builder.roots()
    builder.folders(folders)
    for variable in variables:
        builder.variable(variable)
    for method in METHODS:
        builder.method(method)

    ours = own_nodes(built)
    assert own_nodes(loaded) == ours
    attributes = (
        "BrowseName", "DisplayName", "NodeClass", "DataType", "ValueRank", "ArrayDimensions",
        "AccessLevel", "UserAccessLevel",
    )  # fmt: skip
    for node_id in ours:
        for name in attributes:
            attribute = ua.AttributeIds[name]
            ours_value = built.read_attribute_value(node_id, attribute).Value
            if name == "ArrayDimensions" and node_id.Identifier.endswith(
                ("Strings", "Arguments")
            ):
                continue  # unknown length: absent or [0]
            found = loaded.read_attribute_value(node_id, attribute).Value
            assert found == ours_value, (node_id.Identifier, name)
        assert type_definition(loaded, node_id) == type_definition(built, node_id)
        if node_id.Identifier.endswith(
            ("EURange", "Units", "Strings", "State", "Arguments")
        ):
            assert value(loaded, node_id) == value(built, node_id), node_id


def own_nodes(server: Server) -> set[ua.NodeId]:
    """Return our nodes; asyncua's importer adds numbered ones that describe the namespace."""
    keys = server.iserver.aspace.keys()
    return {k for k in keys if k.NamespaceIndex == 2 and isinstance(k.Identifier, str)}


def value(server: Server, node_id: ua.NodeId) -> object:
    return server.read_attribute_value(node_id, ua.AttributeIds.Value).Value.Value


def type_definition(server: Server, node_id: ua.NodeId) -> list:
    kind = ua.NodeId(ua.ObjectIds.HasTypeDefinition)
    references = server.iserver.aspace[node_id].references
    return [r.NodeId for r in references if r.ReferenceTypeId == kind and r.IsForward]


def test_nodeset_names_units_and_methods(table) -> None:
    text = to_nodeset(table)
    assert f"<uax:UnitId>{UNECE['rpm'].unit_id}</uax:UnitId>" in text
    assert all(f'NodeId="ns=1;s={method.node_id}"' in text for method in METHODS)
