"""`hilserver certs`: from nothing to a server that a trusted client reaches."""

import io
from pathlib import Path

import pytest
import yaml

from hilserver.commands import main
from hilserver.config.server import OpcUaConfig
from hilserver.opcua.certificate import (
    application_uris,
    host_names,
    load_certificate,
    make_certificate,
    make_key,
    thumbprint,
    to_der,
)
from hilserver.opcua.passwords import is_password
from hilserver.opcua.settings import OpcUaUser
from hilserver.opcua.trust_list import CertificateVerdict, TrustList


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "config.yaml"
    path.write_text(yaml.safe_dump({"opcua": {"application_uri": "urn:plant:robot"}}))
    return path


def certs(config: Path, *words: str) -> int:
    return main(["certs", words[0], "-c", str(config), *words[1:]])


def test_make_and_renew(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = config.parent / "certificates" / "own"
    assert certs(config, "make", "--host", "robot.example", "--host", "192.0.2.7") == 0
    first = load_certificate(own / "certificate.der")
    assert application_uris(first) == ["urn:plant:robot"]
    assert host_names(first) == ["robot.example", "192.0.2.7"]
    assert {p.stat().st_mode & 0o777 for p in own.iterdir()} == {0o600}
    assert own.stat().st_mode & 0o777 == 0o700
    assert certs(config, "make") == 1
    assert "use 'hilserver certs renew'" in capsys.readouterr().err
    assert certs(config, "renew", "--days", "10") == 0
    second = load_certificate(own / "certificate.der")
    assert host_names(second) == host_names(first)
    assert second.public_key() == first.public_key()
    assert second.serial_number != first.serial_number
    assert certs(config, "renew", "--new-key") == 0
    certificate, _ = TrustList(own.parent).own()
    assert certificate.public_key() != first.public_key()


@pytest.mark.parametrize("place", ["keys/opcua.pem", "{folder}/elsewhere/opcua.pem"])
def test_the_key_goes_where_the_configuration_wants_it(
    tmp_path: Path, place: str
) -> None:
    key = Path(place.format(folder=tmp_path))
    config = tmp_path / "config.yaml"
    config.write_text(yaml.safe_dump({"opcua": {"private_key": str(key)}}))
    (tmp_path / key).parent.mkdir()
    assert certs(config, "make") == 0
    assert (tmp_path / key).stat().st_mode & 0o777 == 0o600
    assert not (tmp_path / "certificates" / "own" / "key.pem").exists()
    trust = TrustList(tmp_path / "certificates")
    first, private = trust.own(tmp_path / key)
    assert first.public_key() == private.public_key()
    assert certs(config, "make") == 1
    assert certs(config, "renew") == 0
    assert trust.own(tmp_path / key)[0].public_key() == first.public_key()
    assert certs(config, "renew", "--new-key") == 0
    assert trust.own(tmp_path / key)[0].public_key() != first.public_key()


def test_expiry_is_shown(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert certs(config, "list", "--expiring", "5") == 0
    assert capsys.readouterr().out == ""
    assert certs(config, "list") == 0
    assert (
        capsys.readouterr().out == "no certificates; 'hilserver certs make' makes one\n"
    )
    certs(config, "make", "--days", "10")
    capsys.readouterr()
    assert certs(config, "list") == 0
    assert "(9 days left)  hilserver  urn:plant:robot" in capsys.readouterr().out
    assert certs(config, "list", "--expiring", "5") == 0
    assert capsys.readouterr().out == ""
    assert certs(config, "list", "--expiring", "30") == 1


def test_trust_reject_revoke(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trust = TrustList(config.parent / "certificates")
    certificate = make_certificate(
        make_key(), "urn:client", ["c"], common_name="UaExpert@pc"
    )
    data = to_der(certificate)
    trust.keep_rejected(data)
    for words, verdict in (
        (("trust", "UaExpert@pc"), CertificateVerdict.GOOD),
        (
            ("reject", thumbprint(certificate)[:10].lower()),
            CertificateVerdict.UNTRUSTED,
        ),
        (("trust", thumbprint(certificate)), CertificateVerdict.GOOD),
        (("revoke", "UaExpert@pc"), CertificateVerdict.REVOKED),
        (("trust", "UaExpert@pc"), CertificateVerdict.GOOD),
    ):
        assert certs(config, *words) == 0
        assert trust.judge(data) is verdict
    capsys.readouterr()
    assert certs(config, "trust", "nobody") == 1
    assert "no certificate 'nobody' to trust" in capsys.readouterr().err
    certs(config, "list")
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        "trusted"
    ]


def test_trust_a_file(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "client.der"
    certificate = make_certificate(make_key(), "urn:client", [])
    path.write_bytes(to_der(certificate))
    assert certs(config, "trust", str(path)) == 0
    assert (
        TrustList(tmp_path / "certificates").judge(to_der(certificate))
        is CertificateVerdict.GOOD
    )
    path.write_bytes(b"0123")
    assert certs(config, "trust", str(path)) == 1
    assert "is not a certificate" in capsys.readouterr().err


def test_password(
    config: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("geheim\n"))
    assert certs(config, "password") == 0
    text = capsys.readouterr().out.strip()
    assert is_password(b"geheim", text)
    user = OpcUaUser(name="otto", password=text)
    assert "scrypt" not in repr(user)
    OpcUaConfig(endpoint="opc.tcp://192.0.2.1:4840", users=(user,))


def test_secure_server_without_certificate_is_one_sentence(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config.write_text(
        yaml.safe_dump(
            {
                "opcua": {
                    "endpoint": "opc.tcp://127.0.0.1:0/x",
                    "policies": ["Basic256Sha256"],
                    "anonymous": "observer",
                },
                "image": {"name": "auto"},
                "metrics": {"enabled": False},
                "scheduler": {"backend": "virtual"},
            }
        )
    )
    assert main(["run", "-c", str(config), "--duration", "1"]) == 78
    error = capsys.readouterr().err
    assert (
        "certificate.der is missing: make a certificate with 'hilserver certs make'"
        in error
    )
    assert "Traceback" not in error


def test_the_folder_of_one_peer(config: Path, tmp_path: Path) -> None:
    """What `peers[].security.trust` names is kept apart from the clients of our server."""
    trust = TrustList(tmp_path / "plc")
    trust.make_folders()
    certs(config, "make")
    certificate, _ = TrustList(tmp_path / "certificates").own()
    trust.keep_rejected(to_der(certificate))
    assert certs(config, "trust", "--folder", "plc", thumbprint(certificate)[:16]) == 0
    assert [path.parent.name for path in trust.folder.glob("*/*.der")] == ["trusted"]
    assert certs(config, "revoke", "--folder", "plc", "hilserver") == 0
    assert trust.judge(to_der(certificate)) == "BadCertificateRevoked"
