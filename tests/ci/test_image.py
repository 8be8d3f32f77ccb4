"""The OCI image: its layout by the specification, and a container of it that drives."""

import gzip
import hashlib
import importlib.util
import io
import json
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "deploy" / "container" / "image.py"
RUN = "/opt/hilserver/bin/hilserver run -c /etc/hilserver/config.yaml --duration 6"
ASK = """
import time, urllib.request as u
for _ in range(600):
    try:
        print(u.urlopen('http://127.0.0.1:9464/healthz', timeout=2).read().decode())
        break
    except OSError:
        time.sleep(0.1)
"""


def script():
    found = importlib.util.spec_from_file_location("image", SCRIPT)
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def blob(archive, descriptor):
    """Return the bytes that a descriptor names, if its digest and size are right."""
    algorithm, _, digest = descriptor["digest"].partition(":")
    data = archive.extractfile(f"blobs/{algorithm}/{digest}").read()
    assert hashlib.new(algorithm, data).hexdigest() == digest
    assert len(data) == descriptor["size"]
    return data


def read(path):
    """Return configuration and layer of an image, as a reader of the specification finds them."""
    with tarfile.open(path) as archive:
        layout = json.load(archive.extractfile("oci-layout"))
        assert layout == {"imageLayoutVersion": "1.0.0"}
        (entry,) = json.load(archive.extractfile("index.json"))["manifests"]
        manifest = json.loads(blob(archive, entry))
        config = json.loads(blob(archive, manifest["config"]))
        (layer,) = manifest["layers"]
        unpacked = gzip.decompress(blob(archive, layer))
    assert config["rootfs"]["diff_ids"] == [
        f"sha256:{hashlib.sha256(unpacked).hexdigest()}"
    ]
    return entry, config, unpacked


def test_on_an_iot2050_it_is_an_image_for_arm64_with_limits_of_its_own(monkeypatch):
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    image = script()
    assert image.configuration("sha256:0", "1.2.3")["architecture"] == "arm64"
    folder = SCRIPT.parent
    usual, small = (
        yaml.safe_load((folder / name).read_text())["services"]
        for name in ("compose.yaml", "compose.iot2050.yaml")
    )
    assert small.keys() == {"hilserver"}
    assert small["hilserver"]["platform"] == "linux/arm64"
    assert (
        small["hilserver"].keys() - {"platform", "cpuset"} <= usual["hilserver"].keys()
    )


def test_the_layout_is_that_of_the_specification_and_the_same_twice(tmp_path):
    root = tmp_path / "root"
    (root / "etc").mkdir(parents=True)
    (root / "etc/name").write_text("robot")
    (root / "etc/alias").symlink_to("name")
    (root / "etc/name").chmod(0o640)
    image = script()
    first, second = tmp_path / "first.tar", tmp_path / "second.tar"
    image.write_image(root, first, "1.2.3")
    (root / "etc/name").touch()
    image.write_image(root, second, "1.2.3")
    assert first.read_bytes() == second.read_bytes()
    entry, config, unpacked = read(first)
    assert (
        entry["annotations"]["org.opencontainers.image.ref.name"]
        == "localhost/hilserver:1.2.3"
    )
    assert config["os"] == "linux"
    assert config["config"]["User"] == "10001:10001"
    # Where the rest is read-only kernels would be compiled anew in a cache that cannot be written.
    assert config["config"]["Volumes"].keys() == {
        "/var/lib/hilserver",
        "/var/cache/hilserver",
    }
    with tarfile.open(fileobj=io.BytesIO(unpacked)) as layer:
        assert layer.getnames() == [".", "etc", "etc/alias", "etc/name"]
        assert layer.getmember("etc/name").mode == 0o640
        assert layer.getmember("etc/alias").linkname == "name"
        assert {member.mtime for member in layer} == {image.EPOCH}


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    folder = tmp_path_factory.mktemp("image")
    build(["-m", "build", "--wheel", "--outdir", folder, "."])
    (wheel,) = folder.glob("*.whl")
    out = folder / "image.tar"
    build([SCRIPT, wheel, "--out", out, "--work", folder / "work"])
    return out, folder


def build(words):
    command = [sys.executable, *words]
    subprocess.run(
        command, check=True, cwd=ROOT, timeout=1800, stdout=subprocess.DEVNULL
    )


def contained(folder, *words, rights=()):
    """Run a program as the user of the image, in a container that systemd-nspawn makes."""
    variables = [
        f"--setenv={name}={value}" for name, value in script().ENVIRONMENT.items()
    ]
    command = [
        "systemd-nspawn", "--quiet", "--register=no", "--keep-unit", f"--directory={folder}",
        "--volatile=overlay", "--user=hilserver", "--private-network", "--link-journal=no",
        "--resolv-conf=off", "--timezone=off", "--console=pipe", *variables, *rights, "--", *words,
    ]  # fmt: skip
    done = subprocess.run(
        command, check=False, text=True, timeout=300, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    return done.stdout


def missing(output):
    """Return what the audit of a run lacks."""
    records = [json.loads(line) for line in output.splitlines() if line.startswith("{")]
    return set(next(r["missing"] for r in records if "missing" in r).split(", "))


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_container_without_rights_drives_and_says_what_it_lacks(image):
    out, folder = image
    _, _, unpacked = read(out)
    root = folder / "unpacked"
    with tarfile.open(fileobj=io.BytesIO(unpacked)) as layer:
        layer.extractall(root, filter="fully_trusted")
    words = f'{RUN} & /opt/hilserver/bin/python -c "{ASK}"; wait'
    output = contained(root, "/bin/sh", "-c", words)
    assert '"ok": true' in output, output
    assert '"exit_code": 0' in output, output
    assert "compiling" not in output, "a kernel was not in the image"
    alone = missing(output)
    assert {"rtprio_limit", "memlock_limit", "thread_priority"} <= alone
    granted = "CAP_SYS_NICE,CAP_IPC_LOCK"
    rights = (f"--capability={granted}", f"--ambient-capability={granted}")
    with_rights = missing(contained(root, *RUN.split(), rights=rights))
    assert alone - with_rights >= {"rtprio_limit", "memlock_limit", "memory_lock"}
