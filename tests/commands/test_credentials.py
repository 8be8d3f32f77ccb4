"""Certificates and keys that cannot be used: `check` and `run` name file, line and remedy."""

import json
import subprocess
import sys

import pytest

from hilserver.commands import main
from hilserver.errors import EXIT_BAD_CONFIGURATION
from tests.fakes import image_name

IMAGE = f"image: {{name: {image_name()}}}\n"
"""Another daemon may run on this computer, as `robot`."""
PAGE = f"""
opcua: {{enabled: false}}
metrics: {{enabled: false}}
page: {{port: 0, tls: {{certificate: page.pem, key: page.key}}}}
{IMAGE}"""
SERVER = """
metrics: {enabled: false}
page: {enabled: false}
opcua: {endpoint: 'opc.tcp://127.0.0.1:0/x', policies: [Basic256Sha256]}
"""


def openssl(folder, *words):
    subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)


def self_signed(folder):
    words = ["-newkey", "rsa:2048", "-nodes", "-subj", "/CN=localhost", "-days", "2"]
    openssl(folder, "req", "-x509", *words, "-keyout", "page.key", "-out", "page.pem")


def other_key(folder):
    self_signed(folder)
    openssl(folder, "genrsa", "-out", "page.key", "2048")


def key_with_password(folder):
    self_signed(folder)
    openssl(
        folder,
        "genrsa",
        "-aes128",
        "-passout",
        "pass:wheel",
        "-out",
        "page.key",
        "2048",
    )


def junk(folder):
    for name in ("page.pem", "page.key"):
        (folder / name).write_text("junk")


@pytest.mark.parametrize(
    ("prepare", "complaint"),
    [
        (lambda _: None, "page.pem cannot be read: No such file or directory"),
        (junk, "a certificate and its key in PEM form are needed"),
        (other_key, "page.pem does not belong to the key"),
        (key_with_password, "page.key has a password; store it without"),
    ],
)
def test_the_page_does_not_start_without_its_certificate(
    tmp_path, capsys, prepare, complaint
):
    path = tmp_path / "config.yaml"
    path.write_text(PAGE)
    prepare(tmp_path)
    for command in ("check", "run", "page"):
        assert main([command, "-c", str(path)]) == EXIT_BAD_CONFIGURATION
        shown = capsys.readouterr()
        assert f"{path}:4: page.tls: " in shown.err
        assert complaint in shown.err
        assert "operator page" not in shown.err + shown.out


def test_check_accepts_what_openssl_makes(tmp_path, capsys):
    path = tmp_path / "config.yaml"
    path.write_text(PAGE)
    self_signed(tmp_path)
    assert main(["check", "-c", str(path)]) == 0


def test_check_looks_at_the_certificate_of_the_server(tmp_path, capsys):
    path = tmp_path / "config.yaml"
    path.write_text(SERVER)
    check = ["check", "-c", str(path)]
    assert main(check) == EXIT_BAD_CONFIGURATION
    assert f"{path}:4: opcua: " in (missing := capsys.readouterr().err)
    assert "hilserver certs make" in missing
    assert main(["certs", "make", "-c", str(path)]) == 0
    assert main(check) == 0
    (tmp_path / "certificates" / "own" / "key.pem").write_text("junk")
    assert main(check) == EXIT_BAD_CONFIGURATION
    assert (
        "key.pem cannot be used: not a private key in PEM form"
        in capsys.readouterr().err
    )


def test_check_looks_at_the_files_of_peers(tmp_path, capsys):
    path = tmp_path / "config.yaml"
    path.write_text("""peers:
  - name: iot2050
    endpoint: 'opc.tcp://127.0.0.1:4841'
    read: {'ns=1;s=left': wheel.fl.setpoint_rpm}
    security: {user: robot, password_file: secret.txt, allow_clear_password: true}
""")
    assert main(["check", "-c", str(path)]) == EXIT_BAD_CONFIGURATION
    assert (
        f"{path}:2: peers[0]: peer 'iot2050': password_file" in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [
        (
            "user: robot, password_file: secret.txt",
            "password_file: secret.txt cannot be read: No ",
        ),
        (
            "user: robot, password_file: empty.txt",
            "password_file: empty.txt is empty; put the",
        ),
        (
            "tls: {ca: absent.pem}",
            "tls: a file cannot be read: No such file or directory",
        ),
        ("tls: {ca: junk.pem}", "tls: a certificate or key cannot be used: "),
    ],
)
def test_check_and_run_look_at_the_files_of_the_databus(
    tmp_path, capsys, keys, complaint
):
    pytest.importorskip("aiomqtt")
    path = tmp_path / "config.yaml"
    path.write_text(
        f"opcua: {{enabled: false}}\nedge: {{enabled: true, {keys}}}\n{IMAGE}"
    )
    (tmp_path / "empty.txt").write_text("")
    (tmp_path / "junk.pem").write_text("junk")
    for command in ("check", "run"):
        assert main([command, "-c", str(path)]) == EXIT_BAD_CONFIGURATION
        assert f"{path}:2: edge: {complaint}" in capsys.readouterr().err


def test_a_page_by_hand_looks_at_its_own_files_alone(tmp_path, capsys):
    path = tmp_path / "config.yaml"
    path.write_text("""
opcua: {endpoint: 'opc.tcp://127.0.0.1:0/x', policies: [Basic256Sha256]}
page: {port: 0, tls: {certificate: page.pem, key: page.key}}
""")
    for command, key in (("check", "opcua"), ("page", "page.tls")):
        assert main([command, "-c", str(path)]) == EXIT_BAD_CONFIGURATION
        assert f": {key}: " in capsys.readouterr().err


def test_what_run_says_of_certificates_has_the_form_of_the_log(tmp_path):
    path = tmp_path / "config.yaml"
    path.write_text(
        IMAGE
        + """
logging: {format: json}
metrics: {enabled: false}
page: {enabled: false}
opcua: {endpoint: 'opc.tcp://127.0.0.1:0/x'}
scheduler: {backend: virtual}
peers:
  - name: iot2050
    endpoint: 'opc.tcp://127.0.0.1:4841'
    read: {'ns=1;s=left': wheel.fl.setpoint_rpm}
    security: {policy: Basic256Sha256}
"""
    )
    assert main(["certs", "make", "--days", "2", "-c", str(path)]) == 0
    command = [
        sys.executable,
        "-m",
        "hilserver",
        "run",
        "-c",
        str(path),
        "--duration",
        "0.1",
    ]
    ran = subprocess.run(
        command, capture_output=True, text=True, timeout=600, check=True
    )
    assert ran.stdout == ""
    lines = [json.loads(line) for line in ran.stderr.splitlines()]
    assert "certificate ends" in [line["event"] for line in lines]


def test_a_key_of_the_page_that_others_can_read_is_warned_of_once(tmp_path, capsys):
    path = tmp_path / "config.yaml"
    path.write_text(PAGE)
    self_signed(tmp_path)
    (tmp_path / "page.key").chmod(0o644)
    assert main(["check", "-c", str(path)]) == 0
    assert capsys.readouterr().err.count("page.key: can be read by others") == 1
    (tmp_path / "page.key").chmod(0o600)
    assert main(["check", "-c", str(path)]) == 0
    assert "can be read" not in capsys.readouterr().err
