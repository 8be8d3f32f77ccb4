"""Certificates: who is refused, with which status code, and what is kept of it."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from asyncua import ua
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from hilserver.config.root import Config, without_passwords
from hilserver.errors import ConfigError
from hilserver.opcua.certificate import (
    first_of_chain,
    key_to_pem,
    make_certificate,
    make_key,
    thumbprint,
    to_der,
)
from hilserver.opcua.channel import GuardedConnection
from hilserver.opcua.frames import TransportError
from hilserver.opcua.passwords import (
    FailedAttempts,
    hash_password,
    is_password,
    keys_of,
)
from hilserver.opcua.trust_list import (
    KEPT_AT_ONCE,
    KEPT_WITHIN_S,
    MAX_LIST_BYTES,
    MAX_REJECTED,
    CertificateVerdict,
    TrustList,
    file_name,
    files_in,
    write_private,
)
from tests.io.opcua_server.rig import Rig, RobotClient
from tests.security.pki import POLICIES, Identity, Pki

pytestmark = pytest.mark.asyncio(loop_scope="module")
NOW = datetime.now(UTC)


async def refusal(
    rig: Rig, pki: Pki, identity: Identity, policy: str = "Basic256Sha256"
) -> str:
    """Return the name of the status code with which a connection is refused."""
    client = await pki.secure(RobotClient(rig.server.url), "emma", policy, identity)
    try:
        await client.connect()
    except ua.UaStatusCodeError as error:
        return str(ua.StatusCode(error.code).name)
    await client.disconnect()
    return "Good"


@pytest.mark.parametrize("policy", POLICIES)
async def test_trusted_client_connects_with_every_policy(
    ours: Rig, pki: Pki, policy: str
) -> None:
    client = await pki.secure(RobotClient(ours.server.url), "emma", policy)
    async with client:
        ours.set("pose.x_m", 0.25)
        assert await client.read("pose.x_m") == 0.25
        assert await client.write_doubles(wheel__fl__setpoint_rpm=3.0) == ["Good"]
        mode = client.security_policy.Mode
        assert mode is ua.MessageSecurityMode.SignAndEncrypt


async def test_untrusted_is_refused_kept_and_let_in_once_trusted(
    ours: Rig, pki: Pki
) -> None:
    stranger = pki.identity("stranger")
    # OPC 10000-4, 6.1.3: who is not trusted learns no more than BadSecurityChecksFailed.
    with capture_logs() as logs:
        assert await refusal(ours, pki, stranger) == "BadSecurityChecksFailed"
    [line] = [entry for entry in logs if entry["event"] == "opcua certificate refused"]
    name = thumbprint(stranger.certificate)
    assert line["remedy"] == f"compare it, then 'hilserver certs trust {name}'"
    kept = pki.trust.folder / "rejected" / file_name(stranger.certificate)
    assert kept.read_bytes() == stranger.der
    kept.rename(pki.trust.folder / "trusted" / kept.name)
    assert await refusal(ours, pki, stranger) == "Good"


async def test_expired(ours: Rig, pki: Pki) -> None:
    old = pki.identity("old", not_before=NOW - timedelta(days=3), days=2)
    pki.trust_it(old)
    assert await refusal(ours, pki, old) == "BadCertificateTimeInvalid"


async def test_not_yet_valid(ours: Rig, pki: Pki) -> None:
    early = pki.identity("early", not_before=NOW + timedelta(days=2))
    pki.trust_it(early)
    assert await refusal(ours, pki, early) == "BadCertificateTimeInvalid"


async def test_revoked_though_trusted(ours: Rig, pki: Pki) -> None:
    lost = pki.identity("lost")
    pki.trust_it(lost)
    assert await refusal(ours, pki, lost) == "Good"
    pki.revoke(lost)
    assert await refusal(ours, pki, lost) == "BadCertificateRevoked"


async def test_certificate_of_another_application(ours: Rig, pki: Pki) -> None:
    other = pki.identity("other", uri="urn:tests:other")
    pki.trust_it(other)
    other.uri = "urn:tests:pretended"
    assert await refusal(ours, pki, other) == "BadCertificateUriInvalid"
    assert (pki.trust.folder / "rejected" / file_name(other.certificate)).exists()


async def test_server_under_another_name(pki: Pki, tmp_path: Path) -> None:
    """What a client of ours finds out about a server: a certificate of another host or URI."""
    trust = TrustList(tmp_path)
    trust.make_folders()
    write_private(tmp_path / "trusted" / "server.der", pki.server.der)
    judge, der, uri = trust.judge_server, pki.server.der, pki.server.uri
    assert judge(der, "127.0.0.1", uri) is CertificateVerdict.GOOD
    assert judge(der, "LocalHost", uri) is CertificateVerdict.GOOD
    assert judge(der, "192.0.2.1", uri) == "BadCertificateHostNameInvalid"
    assert judge(der, "127.0.0.1", "urn:else") == "BadCertificateUriInvalid"
    assert judge(pki.client.der, "127.0.0.1", uri) == "BadCertificateUntrusted"
    assert (
        judge(der, "127.0.0.1", uri, NOW + timedelta(days=9999))
        == "BadCertificateTimeInvalid"
    )


@pytest.mark.parametrize(
    ("host", "asked"),
    [
        ("2001:db8::1", "2001:0db8:0:0:0:0:0:1"),
        ("robot.example", "Robot.Example."),
    ],
)
async def test_one_host_in_two_ways_of_writing(
    pki: Pki, tmp_path: Path, host: str, asked: str
) -> None:
    certificate = make_certificate(pki.client.key, "urn:x", [host])
    trust = TrustList(tmp_path)
    verdict = trust.judge_server(to_der(certificate), asked, "urn:x", only=certificate)
    assert verdict is CertificateVerdict.GOOD


async def test_a_client_is_no_server_nor_the_other_way_round(
    pki: Pki, tmp_path: Path
) -> None:
    trust, key = TrustList(tmp_path), pki.client.key
    for use, as_client, as_server in (
        (ExtendedKeyUsageOID.CLIENT_AUTH, "Good", "BadCertificateUseNotAllowed"),
        (ExtendedKeyUsageOID.SERVER_AUTH, "BadCertificateUseNotAllowed", "Good"),
    ):
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "one use")])
        names = [x509.UniformResourceIdentifier("urn:x"), x509.DNSName("robot")]
        certificate = (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(name)
            .public_key(key.public_key())
            .serial_number(8)
            .not_valid_before(NOW - timedelta(days=1))
            .not_valid_after(NOW + timedelta(days=1))
            .add_extension(x509.SubjectAlternativeName(names), critical=False)
            .add_extension(x509.ExtendedKeyUsage([use]), critical=False)
            .sign(key, hashes.SHA256())
        )
        der = to_der(certificate)
        assert trust.judge(der, only=certificate) == as_client
        assert trust.judge_server(der, "robot", "urn:x", only=certificate) == as_server


async def test_issued_by_an_authority_until_its_list_says_otherwise(
    ours: Rig, pki: Pki
) -> None:
    authority = pki.authority()
    issued = pki.identity("issued", issuer=authority)
    assert await refusal(ours, pki, issued) == "Good"
    revocations = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(authority[0].subject)
        .last_update(NOW)
        .next_update(NOW + timedelta(days=1))
        .add_revoked_certificate(
            x509.RevokedCertificateBuilder()
            .serial_number(issued.certificate.serial_number)
            .revocation_date(NOW)
            .build()
        )
    )
    path = pki.trust.folder / "revoked" / "authority.crl"
    forged = revocations.sign(make_key(), hashes.SHA256())
    write_private(path, forged.public_bytes(serialization.Encoding.DER))
    assert await refusal(ours, pki, issued) == "Good"
    genuine = revocations.sign(authority[1], hashes.SHA256())
    write_private(path, genuine.public_bytes(serialization.Encoding.PEM))
    assert await refusal(ours, pki, issued) == "BadCertificateRevoked"
    (pki.trust.folder / "trusted" / "authority.der").unlink()
    assert await refusal(ours, pki, issued) == "BadSecurityChecksFailed"


@pytest.fixture
def list_path(pki: Pki) -> Iterator[Path]:
    """Where the revocation list of the authority belongs; nothing is there before and after."""
    path = pki.trust.folder / "revoked" / "authority.crl"
    path.unlink(missing_ok=True)
    yield path
    path.unlink(missing_ok=True)


def write(path: Path, data: bytes) -> None:
    """Write anew in its place."""
    path.write_bytes(data)


@contextmanager
def damaged(path: Path, data: bytes, damage: str) -> Iterator[None]:
    """Have something in the place of a list that is none."""
    if damage == "folder":
        path.mkdir()
        yield
        path.rmdir()
        return
    path.write_bytes(b"garbage" if damage == "garbage" else data[: len(data) // 2])
    if damage == "too large":
        os.truncate(path, MAX_LIST_BYTES + 1)
    yield
    path.unlink()


def long_list(authority: tuple[x509.Certificate, Any], serial_number: int) -> bytes:
    """Return a revocation list of more than a megabyte."""
    long = x509.UnrecognizedExtension(
        x509.ObjectIdentifier("1.2.3.4"), bytes(1_200_000)
    )
    revoked = (
        x509.RevokedCertificateBuilder()
        .serial_number(serial_number)
        .revocation_date(NOW)
    )
    revocations = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(authority[0].subject)
        .last_update(NOW)
        .next_update(NOW + timedelta(days=1))
        .add_revoked_certificate(revoked.build())
        .add_extension(long, critical=False)
    )
    return revocations.sign(authority[1], hashes.SHA256()).public_bytes(
        serialization.Encoding.DER
    )


async def test_a_long_revocation_list_counts(pki: Pki, list_path: Path) -> None:
    authority = pki.authority()
    issued, other = (
        pki.identity(name, issuer=authority) for name in ("issued", "other")
    )
    data = long_list(authority, issued.certificate.serial_number)
    assert len(data) > 1_000_000
    write_private(list_path, data)
    assert pki.trust.judge(issued.der) is CertificateVerdict.REVOKED
    assert pki.trust.judge(other.der) is CertificateVerdict.GOOD


@pytest.mark.parametrize("damage", ["garbage", "half", "too large", "folder"])
async def test_while_a_file_in_revoked_cannot_be_read_nobody_is_let_in(
    pki: Pki, list_path: Path, damage: str
) -> None:
    authority = pki.authority()
    issued = pki.identity("issued", issuer=authority)
    data = long_list(authority, issued.certificate.serial_number)
    with damaged(list_path, data, damage), capture_logs() as lines:
        assert pki.trust.judge(issued.der) is CertificateVerdict.REVOCATION_UNKNOWN
        assert pki.trust.judge(pki.client.der) is CertificateVerdict.REVOCATION_UNKNOWN
    errors = [line for line in lines if line["log_level"] == "error"]
    (error,) = errors  # however many knock
    assert error["file"] == str(list_path)
    assert error["reason"]
    assert "replace or remove" in error["event"]
    assert pki.trust.judge(issued.der) is CertificateVerdict.GOOD


async def test_an_error_that_passes_locks_nobody_out_after_it(
    pki: Pki, list_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the process has no descriptor left, and after that, with the same files."""
    write(list_path, long_list(pki.authority(), 99))

    def fails(*_: object) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    with monkeypatch.context() as patch, capture_logs() as lines:
        patch.setattr("os.open", fails)
        trust = TrustList(pki.trust.folder)
        trust.ours = pki.client.certificate
        verdicts = [trust.judge(pki.client.der) for _ in range(3)]
    assert verdicts == [CertificateVerdict.REVOCATION_UNKNOWN] * 3
    revoked = [line for line in lines if line.get("file") == str(list_path)]
    assert len(revoked) == 1, "it says so once"
    assert trust.judge(pki.client.der) is CertificateVerdict.GOOD


async def test_a_list_that_is_written_anew_in_its_place_counts(
    pki: Pki, list_path: Path
) -> None:
    authority = pki.authority()
    issued = pki.identity("issued", issuer=authority)
    write(list_path, long_list(authority, 99))
    assert pki.trust.judge(issued.der) is CertificateVerdict.GOOD
    write(list_path, long_list(authority, issued.certificate.serial_number))
    assert pki.trust.judge(issued.der) is CertificateVerdict.REVOKED


async def test_stolen_certificate_without_its_key(ours: Rig, pki: Pki) -> None:
    thief = pki.identity("client-copy")
    write_private(thief.certificate_path, pki.client.der)
    write_private(thief.key_path, key_to_pem(make_key()))
    assert await refusal(ours, pki, thief) == "BadSecurityChecksFailed"


async def test_weak_keys_and_other_uses_are_refused(pki: Pki) -> None:
    weak = pki._store("weak", "urn:x", make_key(1024))
    pki.trust_it(weak)
    assert pki.trust.judge(weak.der) is CertificateVerdict.POLICY
    assert pki.trust.judge(b"") is CertificateVerdict.INVALID
    assert pki.trust.judge(weak.der[:-1]) is CertificateVerdict.INVALID


async def test_chain_counts_by_its_first_certificate(pki: Pki) -> None:
    assert first_of_chain(pki.client.der + pki.server.der) == pki.client.der
    assert pki.trust.judge(pki.client.der + pki.server.der) is CertificateVerdict.GOOD


@given(data=st.binary(max_size=300))
async def test_no_bytes_are_a_certificate_by_chance(data: bytes) -> None:
    assert (
        TrustList(Path("/nonexistent")).judge(b"0\x82" + data)
        is CertificateVerdict.INVALID
    )


async def test_rejected_folder_does_not_grow_without_end(
    pki: Pki, tmp_path: Path
) -> None:
    trust = TrustList(tmp_path)
    trust.make_folders()
    rejected = tmp_path / "rejected"
    for i in range(MAX_REJECTED + 5):
        write_private(rejected / f"{i:04}.der", b"x")
    assert trust.keep_rejected(pki.client.der) is not None
    assert len(list(files_in(rejected))) == MAX_REJECTED
    assert (
        oct((rejected / file_name(pki.client.certificate)).stat().st_mode & 0o777)
        == "0o600"
    )


async def test_strangers_with_ever_new_certificates_keep_no_disk_busy(
    pki: Pki, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 1000.0
    monkeypatch.setattr("hilserver.opcua.trust_list.time.monotonic", lambda: now_s)
    trust = TrustList(tmp_path)
    stranger, honest = "192.0.2.66", "192.0.2.7"
    ders = [pki.identity(f"stranger-{i}").der for i in range(KEPT_AT_ONCE + 4)]
    kept = [trust.keep_rejected(der, stranger) for der in ders[:-2]]
    assert [path is not None for path in kept] == [True] * KEPT_AT_ONCE + [False] * 2
    assert trust.keep_rejected(ders[0], stranger) == kept[0], "it is there"
    assert trust.keep_rejected(ders[-1], honest) is not None, (
        "strangers keep nobody else out"
    )
    assert trust.keep_rejected(ders[-2]) is not None, "a server that we connect to"
    now_s += KEPT_WITHIN_S
    assert trust.keep_rejected(ders[-3], stranger) is not None


async def test_the_log_says_why_a_certificate_is_not_kept(
    pki: Pki, tmp_path: Path
) -> None:
    trust = TrustList(tmp_path)
    connection = GuardedConnection([], trust, "192.0.2.66")
    with capture_logs() as lines:
        for i in range(KEPT_AT_ONCE + 1):
            with pytest.raises(TransportError):
                connection._judge(pki.identity(f"stranger-{i}").der)
    *kept, last = (line["kept"] for line in lines)
    assert sorted(kept) == [path.name for path in files_in(tmp_path / "rejected")]
    assert last == "no: too many others lately"


async def test_a_certificate_or_key_is_whole_and_has_its_name_for_good(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder is synced after the file has its name; a full disk leaves what was there."""
    path = tmp_path / "key.pem"
    synced: list[tuple[Path, bool]] = []

    def sync(fd: int) -> None:
        synced.append((Path(f"/proc/self/fd/{fd}").readlink(), path.exists()))

    monkeypatch.setattr(os, "fsync", sync)
    write_private(path, b"key")
    assert [has_name for _, has_name in synced] == [False, True]
    assert synced[-1][0] == tmp_path

    def refuse(fd: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OSError, match="No space"):
        write_private(path, b"another key")
    assert path.read_bytes() == b"key"
    assert os.listdir(tmp_path) == [path.name], "nothing is left beside it"  # noqa: PTH208 - async


async def test_key_that_others_can_read_is_refused(pki: Pki, tmp_path: Path) -> None:
    trust = TrustList(tmp_path)
    trust.make_folders()
    with pytest.raises(
        ConfigError, match="is missing: make a certificate with 'hilserver certs"
    ):
        trust.own()
    own = tmp_path / "own"
    write_private(own / "certificate.der", to_der(pki.server.certificate))
    write_private(own / "key.pem", pki.server.key_path.read_bytes())
    trust.own()
    (own / "key.pem").chmod(0o640)
    with pytest.raises(ConfigError, match="can be read by others: run 'chmod 600"):
        trust.own()
    write_private(own / "key.pem", pki.client.key_path.read_bytes())
    with pytest.raises(ConfigError, match="does not belong to the key"):
        trust.own()
    write_private(own / "key.pem", b"nothing")
    with pytest.raises(ConfigError, match=r"key\.pem cannot be used"):
        trust.own()


# --- users ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("user", "password"), [("emma", "wrong"), ("nobody", "all"), ("", "")]
)
async def test_wrong_name_or_password(
    ours: Rig, pki: Pki, user: str, password: str
) -> None:
    client = await pki.secure(RobotClient(ours.server.url), user, password=password)
    with pytest.raises(
        (ua.uaerrors.BadUserAccessDenied, ua.uaerrors.BadIdentityTokenRejected)
    ):
        await client.connect()


async def test_nobody_is_refused(ours: Rig, pki: Pki) -> None:
    client = await pki.secure(RobotClient(ours.server.url), None)
    with pytest.raises(ua.UaError):
        await client.connect()


async def test_guessing_is_slowed_down_for_that_name(pki: Pki, tmp_path: Path) -> None:
    rig = Rig(tmp_path, max_failed_logins=3, **pki.config())
    await rig.server.start()
    try:
        for password in ("a", "b", "c"):
            assert await login(rig, pki, password) == "BadUserAccessDenied"
        # The right one does not help any more: three wrong ones came for this name.
        assert await login(rig, pki, "all") == "BadUserAccessDenied"
        # beside her on this computer
        assert await login(rig, pki, "drive", "otto") == "Good"
    finally:
        await rig.close()


@pytest.mark.parametrize(
    ("address", "counts"),
    [
        ("192.0.2.7", True),
        ("fe80::1", True),
        ("127.0.0.1", False),
        ("::1", False),
        ("", False),
    ],
)
async def test_log_ins_count_for_the_name_and_for_an_address_of_another_computer(
    address: str, counts: bool
) -> None:
    keys = (("name", "emma"), ("address", address))
    assert keys_of("emma", address) == (keys if counts else keys[:1])


async def login(rig: Rig, pki: Pki, password: str, user: str = "emma") -> str:
    client = await pki.secure(RobotClient(rig.server.url), user, password=password)
    try:
        await client.connect()
    except ua.UaStatusCodeError as error:
        return str(ua.StatusCode(error.code).name)
    await client.disconnect()
    return "Good"


async def test_roles_write(ours: Rig, pki: Pki) -> None:
    found = {}
    for user in ("olga", "otto", "emma"):
        async with await pki.secure(RobotClient(ours.server.url), user) as client:
            (found[user],) = await client.write_doubles(wheel__fl__setpoint_rpm=1.0)
            level = await client.path("wheel.fl.setpoint_rpm").read_attribute(
                ua.AttributeIds.UserAccessLevel
            )
            can_write = bool(level.Value.Value & ua.AccessLevel.CurrentWrite.mask)
            assert can_write is (user != "olga")
    assert found == {"olga": "BadUserAccessDenied", "otto": "Good", "emma": "Good"}


async def test_recordings_carry_no_password_hashes() -> None:
    text = hash_password("geheim", log_n=10)
    users = [{"name": "emma", "password": text, "role": "engineer"}]
    config = Config.model_validate(
        {"opcua": {"users": users, "policies": ["Basic256Sha256"]}}
    )
    carried = without_passwords(config)
    assert text not in str(carried)
    assert Config.model_validate(carried).opcua.users[0].name == "emma"


async def test_passwords() -> None:
    text = hash_password("geheim ü", log_n=10)
    assert hash_password("geheim ü", log_n=10) != text
    assert is_password("geheim ü".encode(), text)
    assert not is_password(b"geheim", text)
    with pytest.raises(ValueError, match="not a scrypt hash"):
        is_password(b"geheim", "geheim")


@given(
    failures=st.lists(st.tuples(st.sampled_from("ab"), st.floats(0, 100)), max_size=60),
    limit=st.integers(1, 5),
)
async def test_blocked_is_who_failed_often_in_the_window(
    failures: list[tuple[str, float]], limit: int
) -> None:
    failures.sort(key=lambda row: row[1])
    attempts = FailedAttempts(limit, 10.0)
    for key, at_s in failures:
        attempts.failed(key, at_s)
    now_s = failures[-1][1] if failures else 0.0
    for key in "ab":
        recent = [at for name, at in failures if name == key and now_s - at < 10.0]
        assert attempts.is_blocked(key, now_s) is (len(recent) >= limit)
        assert not attempts.is_blocked(key, now_s + 10.1)
