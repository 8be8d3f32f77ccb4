"""The shipped files agree with each other and with the embedded controller."""

import json
import re
from xml.etree import ElementTree

from hilserver.controller.nodes import NAMESPACE, SENSORS, SEQUENCE, SETPOINTS
from tests.node_red.node_red import DEPLOY, HERE, shipped_flow

UA = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"


def node(name: str) -> dict:
    return next(item for item in shipped_flow() if item["id"] == name)


def test_nodeset_serves_the_setpoints_unsampled_and_read_only():
    root = ElementTree.parse(DEPLOY / "nodesets" / "iotbot.NodeSet2.xml").getroot()
    assert [uri.text for uri in root.iter(f"{UA}Uri")] == [NAMESPACE]
    variables = list(root.iter(f"{UA}UAVariable"))
    assert {v.get("NodeId") for v in variables} == {
        f"ns=1;s={name}" for name in (*SETPOINTS, SEQUENCE)
    }
    assert {v.get("MinimumSamplingInterval") for v in variables} == {"0"}
    assert {v.get("AccessLevel") for v in variables} == {"1"}


def test_flow_takes_the_sensors_and_sends_every_setpoint_stamped():
    created = re.findall(r"(\w+): \"Double\"", node("router")["func"])
    assert set(created) == set(SENSORS)
    cycle = node("setpoints")["func"]
    assert "quality" in cycle
    assert "sourceTimestamp" in cycle
    assert float(node("cycle")["repeat"]) == 0.02


def test_address_is_the_one_of_the_documentation_and_nothing_is_secret():
    server = node("server")
    assert (server["port"], server["endpoint"]) == ("53880", "UA/NodeRedAgv")
    assert server["usersFile"] == ""
    assert server["autoAcceptUnknownCertificate"] is False
    assert "credentials" not in json.dumps(shipped_flow())


def test_one_version_of_node_red_everywhere():
    packages = [json.loads((p / "package.json").read_text()) for p in (DEPLOY, HERE)]
    assert packages[0]["dependencies"] == packages[1]["dependencies"]
    assert packages[0]["dependencies"] == {
        "node-red": "4.1.8",
        "node-red-contrib-opcua": "0.2.354",
    }
