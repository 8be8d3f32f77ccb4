"""A protected link to a real Node-RED: each side trusts the other's certificate first."""

import json
import socket

import pytest

from hilserver.config.server import OpcUaConfig
from hilserver.io.opcua_client import LinkSecurity
from hilserver.io.peer_link import samples as peer_errors
from hilserver.opcua.certificate import (
    key_to_pem,
    make_certificate,
    make_key,
    to_der,
)
from hilserver.opcua.trust_list import TrustList, write_private
from tests.io.opcua_client.conftest import make_harness, peer_config, wait_until
from tests.node_red.node_red import DEPLOY

pytestmark = pytest.mark.node_red


async def test_the_shipped_flow_over_basic256sha256(node_red, tmp_path, monkeypatch):
    monkeypatch.setattr(peer_errors, "REFUSED_PAUSE_S", 0.2)
    flow = json.loads((DEPLOY / "flows.json").read_text(encoding="utf-8"))
    robot = await node_red(flow).start()
    trust = TrustList(tmp_path / "certificates")
    trust.make_folders()
    key = make_key()
    certificate = make_certificate(key, "urn:tests:hilserver", ["127.0.0.1"])
    write_private(trust.folder / "own" / "certificate.der", to_der(certificate))
    write_private(trust.folder / "own" / "key.pem", key_to_pem(key))

    config = peer_config(
        robot.port,
        endpoint=robot.endpoint,
        mode="poll",
        security={"policy": "Basic256Sha256", "peer_host": socket.gethostname()},
    )
    harness = make_harness(
        config, security=LinkSecurity(config, OpcUaConfig(), tmp_path)
    )
    await harness.link.start()
    try:
        await wait_until(lambda: harness.heard("is not trusted"))
        (kept,) = (trust.folder / "rejected").iterdir()
        kept.rename(trust.folder / "trusted" / kept.name)
        await wait_until(lambda: harness.heard("our certificate"))
        (rejected,) = robot.home.glob("**/rejected/*.pem")
        rejected.rename(rejected.parent.parent / "trusted" / "certs" / rejected.name)
        await robot.stop()
        await robot.start()
        await wait_until(lambda: harness.status.sequence_received > 10)
        assert harness.status.faults == {}
    finally:
        await harness.link.stop()
