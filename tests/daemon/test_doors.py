"""The table of doors, and the doors that lost a right."""

from hilserver.config.root import Config
from hilserver.daemon.doors import doors_lost, rows_of, table_of_doors
from tests.config.test_doors import USERS

PEER = {
    "name": "plc",
    "endpoint": "opc.tcp://h:1",
    "read": {"ns=1;s=a": "wheel.fl.setpoint_rpm"},
}


def config_of(**sections):
    return Config.model_validate({"foxglove": {"enabled": True}, **sections})


def test_without_users_everyone_may_everything():
    rows = {row.title: row for row in rows_of(config_of())}
    assert set(rows["OPC UA"][1:]) == {"everyone"}
    assert rows["Foxglove"][1:3] == ("everyone", "everyone")
    assert doors_lost(config_of()) == []


def test_with_users_people_have_roles_and_a_door_without_a_log_in_watches():
    config = config_of(opcua=USERS, peers=[PEER], shield={"enabled": True})
    rows = {row.title: row for row in rows_of(config)}
    assert rows["OPC UA"][1:] == ("operator", "operator", "engineer", "engineer")
    assert rows["page"][1:] == rows["shell"][1:] == rows["OPC UA"][1:]
    assert set(rows["Foxglove"][1:]) == {"-"}
    assert rows["peer plc"].command == rows["shield"].command == "its section"
    assert rows["peer plc"].measured == "-"
    assert rows["scenario"].command == "operator"
    [sentence] = doors_lost(config)
    assert "'foxglove.grants: [measured, command]' grants it" in sentence


def test_permissions_are_those_of_the_table():
    strict = {"permissions": {"write": {"*": "operator", "measured.*": "engineer"}}}
    rows = {row.title: row for row in rows_of(config_of(opcua=USERS | strict))}
    assert rows["OPC UA"].measured == "engineer"


def test_the_table_has_a_line_per_door():
    lines = table_of_doors(config_of(opcua=USERS))
    assert [line.split()[0] for line in lines][:2] == ["door", "OPC"]
    assert len({len(line.rstrip()) <= 80 for line in lines}) == 1
