"""Both sides of a protected link, and a relay between them that keeps what was said."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
from asyncua import ua
from cryptography import x509

from hilserver.config.peers import PeerConfig
from hilserver.config.server import OpcUaConfig
from hilserver.io.opcua_client import LinkSecurity
from hilserver.io.peer_link import samples as peer_errors
from hilserver.opcua.certificate import (
    make_certificate,
    to_der,
)
from hilserver.opcua.settings import default_application_uri
from hilserver.opcua.trust_list import TrustList, file_name, write_private
from tests.io.opcua_client.conftest import Harness, make_harness, wait_until
from tests.io.opcua_server.rig import Rig
from tests.security.pki import PASSWORDS, Pki

ROBOT = "nsu=urn:hilserver:robot;s="
SERVER_URI = default_application_uri()


class Station:
    """Our side: a folder of certificates, a password, and links made from them."""

    def __init__(self, pki: Pki, folder: Path) -> None:
        self.folder = folder
        self.trust = TrustList(folder / "certificates")
        self.trust.make_folders()
        own = self.trust.folder / "own"
        write_private(own / "certificate.der", pki.client.der)
        write_private(own / "key.pem", pki.client.key_path.read_bytes())
        self.password("otto")

    def password(self, user: str, text: str | None = None) -> None:
        write_private(
            self.folder / "password", (text or PASSWORDS[user]).encode() + b"\n"
        )

    def put(self, folder: str, certificate: x509.Certificate) -> None:
        write_private(
            self.trust.folder / folder / file_name(certificate), to_der(certificate)
        )

    def link(
        self, url: str, nodes: dict[str, Any] | None = None, **security: Any
    ) -> Harness:
        log_in = {"user": "otto", "password_file": "password"}
        config = PeerConfig.model_validate(
            {
                "name": "iot2050",
                "endpoint": url,
                "mode": "poll",
                "read": {f"{ROBOT}pose.x_m": "wheel.fl.setpoint_rpm"},
                "write": {"wheel.fl.speed_rpm": f"{ROBOT}wheel.fl.setpoint_rpm"},
                "security": {"policy": "Basic256Sha256"} | log_in | security,
            }
            | (nodes or {})
        )
        harness = make_harness(
            config, security=LinkSecurity(config, OpcUaConfig(), self.folder)
        )
        harness.outputs["wheel.fl.speed_rpm"] = (7.5, 0)
        return harness


@contextlib.asynccontextmanager
async def robot(pki: Pki, folder: Path, **config: Any) -> AsyncIterator[Rig]:
    rig = Rig(folder, **pki.config() | config)
    await rig.server.start()
    rig.control.started()
    rig.gate.request("opcua", "opcua")
    rig.set("pose.x_m", 1.25)
    try:
        yield rig
    finally:
        await rig.close()


@contextlib.asynccontextmanager
async def running(harness: Harness) -> AsyncIterator[Harness]:
    await harness.link.start()
    try:
        yield harness
    finally:
        await harness.link.stop()


def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peer_errors, "REFUSED_PAUSE_S", 0.05)
    monkeypatch.setattr(peer_errors, "LOG_IN_PAUSE_S", 0.05)


def written(rig: Rig) -> float:
    rig.tick()
    return float(rig.image.frame_values[rig.table.slot("wheel.fl.setpoint_rpm")])


async def refused(harness: Harness, attempts: int = 3) -> str:
    """Run the link for some attempts; return the sentence, which must have been told once."""
    async with running(harness):
        await wait_until(lambda: harness.status.failed_attempts >= attempts)
        assert not harness.status.connected
        (key, sentence) = next(iter(harness.status.faults.items()))
        assert len(harness.status.faults) == 1
    assert harness.status.last_error == sentence
    assert harness.status.last_connect_ns is None
    assert harness.status.fault_counts[key.split(":")[0]] >= attempts
    told = [e for e in harness.events.recent if e.kind == "peer_fault"]
    assert [event.message for event in told] == [f"peer iot2050: {sentence}"]
    assert harness.gate.groups == []
    return sentence


def rest(rig: Rig) -> None:
    rig.gate.write("opcua", {"wheel.fl.setpoint_rpm": 0.0})
    rig.tick()


@contextlib.contextmanager
def showing(rig: Rig, certificate: x509.Certificate, key: Any = None) -> Iterator[None]:
    """Let a running server have another certificate, and another key than belongs to it."""
    server = rig.server._server
    factories = [f for f in server._policies if f.certificate is not None]
    endpoints = server.iserver.endpoints
    before = (server.iserver.certificate, server.iserver.private_key)

    def use(certificate: x509.Certificate, key: Any) -> None:
        server.iserver.certificate, server.iserver.private_key = certificate, key
        for factory in factories:
            factory.certificate, factory.private_key = certificate, key
        for endpoint in endpoints:
            endpoint.ServerCertificate = to_der(certificate)

    use(certificate, key or before[1])
    try:
        yield
    finally:
        use(*before)


def certificate_of(
    pki: Pki, hosts: Any = ("127.0.0.1",), **more: Any
) -> x509.Certificate:
    return make_certificate(
        pki.server.key, SERVER_URI, hosts, common_name="robot", **more
    )


@contextlib.asynccontextmanager
async def relay(port: int) -> AsyncIterator[tuple[str, bytearray]]:
    """Pass on to a server what comes, and keep what the client said."""
    seen = bytearray()

    async def pump(reader: Any, writer: Any, keep: bool) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                if keep:
                    seen.extend(data)
                writer.write(data)
        writer.close()

    async def serve(reader: Any, writer: Any) -> None:
        there, back = await asyncio.open_connection("127.0.0.1", port)
        await asyncio.gather(pump(reader, back, True), pump(there, writer, False))

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield f"opc.tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}/", seen
    finally:
        server.close()
        await server.wait_closed()


def was_sent(seen: bytearray, request: str) -> bool:
    number = getattr(ua.ObjectIds, f"{request}Request_Encoding_DefaultBinary")
    return b"\x01\x00" + number.to_bytes(2, "little") in seen
