"""Protected links against our own hardened server and stock ones, over loopback."""

import asyncio
import shutil
from collections.abc import AsyncIterator, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Server, ua

from hilserver.config.server import OpcUaConfig
from hilserver.errors import ConfigError
from hilserver.io.opcua_client import session
from hilserver.io.peer_link import samples as peer_errors
from hilserver.opcua.access import Access
from hilserver.opcua.certificate import (
    key_to_pem,
    make_certificate,
    make_key,
    to_der,
)
from hilserver.opcua.trust_list import TrustList, file_name, write_private
from tests.io.opcua_client.conftest import make_harness, wait_until
from tests.io.opcua_client.secured import (
    SERVER_URI,
    Station,
    certificate_of,
    quick,
    refused,
    relay,
    rest,
    robot,
    running,
    showing,
    was_sent,
    written,
)
from tests.io.opcua_server.rig import Rig
from tests.security.pki import POLICIES, Pki
from tests.security.stock import Stock

pytestmark = pytest.mark.asyncio(loop_scope="module")
NOW = datetime.now(UTC)


@pytest.fixture(scope="module")
def pki(tmp_path_factory: pytest.TempPathFactory) -> Pki:
    return Pki(tmp_path_factory.mktemp("pki"))


@pytest.fixture
def station(pki: Pki, tmp_path: Path) -> Station:
    return Station(pki, tmp_path)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def ours(
    pki: Pki, tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[Rig]:
    async with robot(pki, tmp_path_factory.mktemp("snapshots")) as rig:
        yield rig


@pytest.fixture
def log_ins(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[bytes]]:
    """Passwords that our server was given."""
    seen: list[bytes] = []
    log_in = Access.log_in

    async def record(self: Access, name: str, password: bytes, address: str) -> Any:
        seen.append(password)
        return await log_in(self, name, password, address)

    monkeypatch.setattr(Access, "log_in", record)
    return seen


# --- what works -----------------------------------------------------------------------------------


@pytest.mark.parametrize("policy", POLICIES)
async def test_reads_and_writes_with_every_policy(
    ours: Rig, pki: Pki, station: Station, log_ins: list[bytes], policy: str
) -> None:
    station.put("trusted", pki.server.certificate)
    rest(ours)
    harness = station.link(ours.server.url, policy=policy)
    async with running(harness):
        await wait_until(lambda: harness.gate.latest == {"wheel.fl.setpoint_rpm": 1.25})
        await wait_until(lambda: harness.status.writes > 1 and written(ours) == 7.5)
        assert harness.status.faults == {}
    assert log_ins == [b"drive"]


async def test_the_channel_is_really_encrypted(
    ours: Rig, pki: Pki, station: Station
) -> None:
    station.put("trusted", pki.server.certificate)
    async with relay(ours.server._server.bserver.port) as (url, seen):
        harness = station.link(url)
        async with running(harness):
            await wait_until(lambda: harness.status.writes > 1)
    assert b"SecurityPolicy#Basic256Sha256" in seen
    assert b"wheel.fl.setpoint_rpm" not in seen


async def test_trusted_by_its_file_alone(ours: Rig, pki: Pki, station: Station) -> None:
    harness = station.link(
        ours.server.url, peer_certificate=str(pki.server.certificate_path)
    )
    async with running(harness):
        await wait_until(lambda: harness.status.connected)


async def test_trusted_through_its_authority(
    ours: Rig, pki: Pki, station: Station
) -> None:
    authority = pki.authority()
    station.put("trusted", authority[0])
    with showing(ours, certificate_of(pki, issuer=authority)):
        async with running(station.link(ours.server.url)) as harness:
            await wait_until(lambda: harness.status.writes > 1)


async def test_reached_by_an_address_that_the_certificate_does_not_name(
    ours: Rig, pki: Pki, station: Station
) -> None:
    certificate = certificate_of(pki, ["robot.example"])
    station.put("trusted", certificate)
    with showing(ours, certificate):
        async with running(
            station.link(ours.server.url, peer_host="robot.example")
        ) as harness:
            await wait_until(lambda: harness.status.connected)


async def test_own_certificate_key_and_trust_of_one_peer(
    ours: Rig, pki: Pki, station: Station, tmp_path: Path
) -> None:
    elsewhere = TrustList(tmp_path / "elsewhere")
    elsewhere.make_folders()
    write_private(elsewhere.folder / "trusted" / "robot.der", pki.server.der)
    harness = station.link(
        ours.server.url,
        certificate=str(pki.client.certificate_path),
        private_key=str(pki.client.key_path),
        trust="elsewhere",
    )
    async with running(harness):
        await wait_until(lambda: harness.status.connected)


# --- the peer's certificate -----------------------------------------------------------------------


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "expired": (
        {"not_before": NOW - timedelta(days=3), "days": 2},
        "BadCertificateTimeInvalid",
    ),
    "not yet valid": (
        {"not_before": NOW + timedelta(days=2)},
        "BadCertificateTimeInvalid",
    ),
    "another host": ({"hosts": ["192.0.2.7"]}, "names 192.0.2.7, not 127.0.0.1"),
}


@pytest.mark.parametrize("case", [*BAD, "untrusted", "revoked", "another application"])
async def test_a_bad_certificate_is_refused_before_anything_is_said(
    ours: Rig,
    pki: Pki,
    station: Station,
    log_ins: list[bytes],
    monkeypatch: pytest.MonkeyPatch,
    case: str,
) -> None:
    quick(monkeypatch)
    rest(ours)
    changes, reason = BAD.get(case, ({}, ""))
    certificate = certificate_of(pki, **changes)
    if case != "untrusted":
        station.put("trusted", certificate)
    with showing(ours, certificate):
        if case == "untrusted":
            reason = "is not trusted: compare it, then 'hilserver certs trust"
        elif case == "revoked":
            station.put("revoked", certificate)
            reason = "its certificate is revoked (BadCertificateRevoked)"
        elif case == "another application":
            for endpoint in ours.server._server.iserver.endpoints:
                monkeypatch.setattr(endpoint.Server, "ApplicationUri", "urn:another")
            reason = "it announces the application URI urn:another"
        sentence = await refused(station.link(ours.server.url))
    assert reason in sentence
    assert log_ins == []
    assert written(ours) == 0.0
    kept = station.trust.folder / "rejected" / file_name(certificate)
    assert kept.exists() == (case == "untrusted")


async def test_the_same_certificate_connects_once_nothing_is_wrong_with_it(
    ours: Rig, pki: Pki, station: Station, log_ins: list[bytes]
) -> None:
    certificate = certificate_of(pki)
    station.put("trusted", certificate)
    with showing(ours, certificate):
        async with running(station.link(ours.server.url)) as harness:
            await wait_until(lambda: harness.status.writes > 1)
    assert log_ins == [b"drive"]


async def test_connects_as_soon_as_the_rejected_certificate_is_trusted(
    ours: Rig, pki: Pki, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick(monkeypatch)
    harness = station.link(ours.server.url)
    async with running(harness):
        await wait_until(lambda: harness.status.failed_attempts >= 2)
        assert list(harness.status.faults) == ["certificate:BadCertificateUntrusted"]
        kept = station.trust.folder / "rejected" / file_name(pki.server.certificate)
        kept.rename(station.trust.folder / "trusted" / kept.name)
        await wait_until(lambda: harness.status.connected)
        assert harness.status.faults == {}


async def test_a_certificate_that_cannot_be_kept_has_another_mend(
    ours: Rig, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick(monkeypatch)
    (station.trust.folder / "rejected").rmdir()
    (station.trust.folder / "rejected").write_text("no folder")
    sentence = await refused(station.link(ours.server.url))
    assert f"is not trusted: put it into {station.trust.folder}/trusted" in sentence


async def test_trust_taken_away_ends_the_session(
    ours: Rig, pki: Pki, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick(monkeypatch)
    monkeypatch.setattr(session, "TRUST_EVERY_S", 0.05)
    station.put("trusted", pki.server.certificate)
    harness = station.link(ours.server.url)
    async with running(harness):
        await wait_until(lambda: harness.status.connected and not harness.status.stale)
        station.put("revoked", pki.server.certificate)
        await wait_until(lambda: not harness.status.connected)
        await wait_until(lambda: harness.stale == ["peer:iot2050"])
        assert harness.heard("its certificate is revoked")


async def test_a_stranger_with_a_stolen_certificate_gets_no_password(
    ours: Rig, pki: Pki, station: Station, log_ins: list[bytes]
) -> None:
    """It shows what we trust, but has not the key."""
    rest(ours)
    station.put("trusted", pki.server.certificate)
    with showing(ours, pki.server.certificate, make_key()):
        async with running(station.link(ours.server.url)) as harness:
            await wait_until(lambda: harness.status.failed_attempts >= 1)
    assert harness.status.last_connect_ns is None
    assert log_ins == []
    assert written(ours) == 0.0


async def test_reconnects_to_a_restarted_peer_with_a_renewed_certificate(
    pki: Pki, station: Station, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick(monkeypatch)
    folder = tmp_path / "server"
    shutil.copytree(pki.trust.folder, folder)
    station.put("trusted", pki.server.certificate)
    async with robot(pki, tmp_path, certificates=folder) as rig:
        url = rig.server.url
        harness = station.link(url)
        async with running(harness):
            await wait_until(lambda: harness.status.connected)
            await rig.server.stop()
            await wait_until(lambda: not harness.status.connected)
            key = make_key()
            renewed = make_certificate(
                key, SERVER_URI, ["127.0.0.1"], common_name="renewed"
            )
            write_private(folder / "own" / "certificate.der", to_der(renewed))
            write_private(folder / "own" / "key.pem", key_to_pem(key))
            rig.server = rig.make_server(endpoint=url)
            await rig.server.start()
            rig.set("pose.x_m", 2.5)
            await wait_until(lambda: harness.heard("is not trusted"))
            station.put("trusted", renewed)
            await wait_until(
                lambda: harness.gate.latest == {"wheel.fl.setpoint_rpm": 2.5}
            )
            assert harness.status.reconnects == 1


# --- policies, modes and users --------------------------------------------------------------------


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def signing(pki: Pki) -> AsyncIterator[Stock]:
    """A stock server that offers no encryption."""
    offered = [
        ua.SecurityPolicyType.NoSecurity,
        ua.SecurityPolicyType.Basic256Sha256_Sign,
    ]
    stock, choose = Stock(), Server.set_security_policy
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            Server, "set_security_policy", lambda server, _: choose(server, offered)
        )
        await stock.start(pki)
    yield stock
    await stock.stop()


STOCK_NODES = {
    "read": {"nsu=urn:stock;s=speed": "wheel.fl.setpoint_rpm"},
    "write": {},
}


async def test_no_fall_back_to_less_protection(
    signing: Stock, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick(monkeypatch)
    async with relay(signing.server.bserver.port) as (url, seen):
        sentence = await refused(station.link(url, STOCK_NODES))
    offers = "the server offers: None (None_), Basic256Sha256 (Sign);"
    assert f"no endpoint with Basic256Sha256 and sign_and_encrypt; {offers}" in sentence
    assert was_sent(seen, "GetEndpoints")
    assert not any(
        was_sent(seen, request) for request in ("CreateSession", "ActivateSession")
    )
    assert b"drive" not in seen


async def test_our_own_server_offers_no_mere_signing(
    ours: Rig, pki: Pki, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick(monkeypatch)
    station.put("trusted", pki.server.certificate)
    sentence = await refused(station.link(ours.server.url, mode="sign"))
    assert "Basic256Sha256 and sign;" in sentence
    assert "Aes256Sha256RsaPss (SignAndEncrypt)" in sentence


async def test_mode_sign_where_it_is_offered(
    pki: Pki, signing: Stock, station: Station
) -> None:
    station.put("trusted", pki.server.certificate)
    anonymous = {"user": None, "password_file": None}
    async with relay(signing.server.bserver.port) as (url, seen):
        harness = station.link(url, STOCK_NODES, mode="sign", **anonymous)
        async with running(harness):
            await wait_until(
                lambda: harness.gate.latest == {"wheel.fl.setpoint_rpm": 0.0}
            )
    assert was_sent(seen, "ActivateSession")


@pytest.mark.parametrize(
    "uri", ["http://opcfoundation.org/UA/SecurityPolicy#None", "urn:weak"]
)
async def test_no_password_that_others_can_read_over_a_signed_link(
    pki: Pki,
    signing: Stock,
    station: Station,
    monkeypatch: pytest.MonkeyPatch,
    uri: str,
) -> None:
    quick(monkeypatch)
    station.put("trusted", pki.server.certificate)
    for endpoint in signing.server.iserver.endpoints:
        for token in endpoint.UserIdentityTokens:
            monkeypatch.setattr(token, "SecurityPolicyUri", uri)
    async with relay(signing.server.bserver.port) as (url, seen):
        sentence = await refused(station.link(url, STOCK_NODES, mode="sign"))
    assert "it asks for the password with" in sentence
    assert was_sent(seen, "CreateSession")
    assert not was_sent(seen, "ActivateSession")
    assert b"drive" not in seen


async def test_a_wrong_password_is_named_and_not_tried_in_haste(
    ours: Rig, pki: Pki, station: Station, log_ins: list[bytes]
) -> None:
    station.put("trusted", pki.server.certificate)
    station.password("otto", "wrong")
    harness = station.link(ours.server.url)
    async with running(harness):
        await wait_until(
            lambda: harness.heard("refuses user 'otto': check user and password_file")
        )
        await asyncio.sleep(1.0)
        assert log_ins == [b"wrong"]
    attempts_per_minute = 60 / peer_errors.LOG_IN_PAUSE_S
    assert attempts_per_minute < OpcUaConfig().max_failed_logins
    assert "wrong" not in harness.status.last_error


async def test_a_server_without_anonymous_clients_asks_for_a_user(
    ours: Rig, pki: Pki, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick(monkeypatch)
    station.put("trusted", pki.server.certificate)
    harness = station.link(ours.server.url, user=None, password_file=None)
    assert "set user and password_file" in await refused(harness)


async def test_a_server_that_does_not_know_us_is_named(
    ours: Rig, pki: Pki, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick(monkeypatch)
    station.put("trusted", pki.server.certificate)
    known = pki.trust.folder / "trusted" / "client.der"
    known.unlink()
    try:
        sentence = await refused(station.link(ours.server.url))
    finally:
        pki.trust_it(pki.client)
    assert "it refuses our certificate" in sentence
    assert "trust it there" in sentence


async def test_an_unprotected_link_to_a_protected_server_is_named(
    ours: Rig, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick(monkeypatch)
    nothing = {"policy": "None", "user": None, "password_file": None}
    assert "set security" in await refused(station.link(ours.server.url, **nothing))


# --- files ----------------------------------------------------------------------------------------


async def test_files_that_are_missing_or_open_are_one_sentence(
    station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = "opc.tcp://127.0.0.1:4840/"
    secret = station.folder / "password"
    secret.chmod(0o644)
    with pytest.raises(
        ConfigError, match=r"peer 'iot2050': .*password can be read by others: run"
    ):
        station.link(url)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(station.folder))
    # systemd guards the folder; the bits of a file there show an access list
    station.link(url)
    monkeypatch.delenv("CREDENTIALS_DIRECTORY")
    for text, message in ((b"", "must be a password"), (b"\xff\n", "contains no text")):
        write_private(secret, text)
        with pytest.raises(ConfigError, match=message):
            station.link(url)
    secret.unlink()
    with pytest.raises(
        ConfigError, match=r"password_file .* cannot be read: No such file"
    ):
        station.link(url)
    station.password("otto")
    with pytest.raises(
        ConfigError, match=r"peer 'iot2050': .*none\.der cannot be read"
    ):
        station.link(url, peer_certificate="none.der")
    with pytest.raises(ConfigError, match="password is not a certificate"):
        station.link(url, peer_certificate="password")
    (station.trust.folder / "own" / "certificate.der").unlink()
    with pytest.raises(
        ConfigError, match="make a certificate with 'hilserver certs make'"
    ):
        station.link(url)


async def test_a_link_is_never_less_protected_than_configured(station: Station) -> None:
    harness = station.link("opc.tcp://127.0.0.1:4840/")
    with pytest.raises(ValueError, match="asks for a protected link"):
        make_harness(harness.link.config)
    assert peer_errors.refusal_in(ValueError()) is None
