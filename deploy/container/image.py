"""Makes an OCI image from a wheel, without a registry: ``make image`` (as root, on Debian).

A minimal Debian by debootstrap, a wheel without compiled code in an environment of its own, the
compiled code for this environment and any processor of this architecture, a user without rights.
The layout is written here (OCI image specification 1.0), so that no container engine is needed;
every engine reads the file.
"""

import argparse
import gzip
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

EPOCH = int(os.environ.get("SOURCE_DATE_EPOCH", "1767225600"))
USER_ID = 10001
SUITE = "bookworm"
PACKAGES = "python3,python3-venv"
PYTHON = "3.11"  # of this suite
HOME = "opt/hilserver"
OBJECTS = f"{HOME}/lib/python{PYTHON}/site-packages/hilserver/compiled/objects"
WITHOUT = ("usr/share/doc", "usr/share/man", "usr/share/locale", "var/cache", "var/lib/apt/lists",
           "var/log", "tmp", "run", "root")  # fmt: skip
ANY_PORT = """
image: {name: auto}
opcua: {endpoint: "opc.tcp://127.0.0.1:0/hilserver"}
metrics: {port: 0}
page: {enabled: false}
"""
PLATFORM = {"x86_64": ("amd64", "x86_64"), "aarch64": ("arm64", "aarch64")}
ENVIRONMENT = {
    "PATH": f"/{HOME}/bin:/usr/bin:/bin",
    "HILSERVER_CACHE_DIR": "/var/cache/hilserver",
    "PYTHONUNBUFFERED": "1",
    "PYTHONDONTWRITEBYTECODE": "1",
}


def main() -> int:
    """Make the image; print where it is and how large."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="archive to write")
    parser.add_argument(
        "--work", type=Path, required=True, help="folder; keeps the base system"
    )
    parser.add_argument(
        "--extras", default="edge,foxglove", help="extras, comma-separated"
    )
    args = parser.parse_args()
    if os.geteuid() != 0:
        print(
            "run this as root: debootstrap creates the file system of the image",
            file=sys.stderr,
        )
        return 1
    if shutil.which("debootstrap") is None:
        print(
            "debootstrap is missing: run 'apt-get install debootstrap'", file=sys.stderr
        )
        return 1
    base, root = args.work / "base", args.work / "root"
    if not base.exists():
        make_base(base)
    shutil.rmtree(root, ignore_errors=True)
    run("cp", "-a", "--reflink=auto", base, root)
    install(root, args.wheel, args.extras, args.work / "wheels")
    settle(root)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    version = args.wheel.name.split("-")[1]
    write_image(root, args.out, version)
    print(f"{args.out}: {args.out.stat().st_size / 1e6:.0f} MB, hilserver {version}")
    return 0


def run(*words: object) -> None:
    """Run a program; what it says appears if it fails."""
    done = subprocess.run(  # noqa: S603 -- words of this script
        [str(word) for word in words],
        check=False,
        text=True,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, words))}:\n{done.stdout[-4000:]}")


def within(root: Path, *words: object) -> None:
    """Run a program in the image, in name spaces of its own, with /proc and shared memory."""
    mounts = 'mount -t proc proc $0/proc && mount -t tmpfs tmpfs $0/dev/shm && exec chroot $0 "$@"'
    variables = [f"{name}={value}" for name, value in ENVIRONMENT.items()]
    run("unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", mounts, root,
        "/usr/bin/env", "-i", *variables, *words)  # fmt: skip


def make_base(base: Path) -> None:
    """Make a minimal Debian with Python."""
    partial = base.with_suffix(".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.parent.mkdir(parents=True, exist_ok=True)
    run("debootstrap", "--variant=minbase", f"--include={PACKAGES}", SUITE, partial)
    partial.rename(base)


def install(root: Path, wheel: Path, extras: str, wheels: Path) -> None:
    """Install the wheel and what it needs; the image itself needs no network."""
    machine = PLATFORM[platform.machine()][1]
    wanted = (
        f"hilserver[{extras}] @ {wheel.resolve().as_uri()}" if extras else str(wheel)
    )
    tags = [f"--platform={tag}_{machine}" for tag in
            ("manylinux_2_36", "manylinux_2_28", "manylinux_2_17", "manylinux2014")]  # fmt: skip
    wheels.mkdir(parents=True, exist_ok=True)
    run(sys.executable, "-m", "pip", "download", "--quiet", "--only-binary=:all:", *tags,
        f"--python-version={PYTHON}", "--constraint=constraints.txt", "--dest", wheels,
        wanted)  # fmt: skip
    inside = root / "wheels"
    shutil.copytree(wheels, inside)
    within(root, "/usr/bin/python3", "-m", "venv", f"/{HOME}")
    named = f"/wheels/{wheel.name}" + (f"[{extras}]" if extras else "")
    offline = ("--quiet", "--no-compile", "--no-index", "--find-links=/wheels")
    within(root, f"/{HOME}/bin/pip", "install", *offline, named)
    shutil.rmtree(inside)


def settle(root: Path) -> None:
    """Fix all times, compile, add the user: nothing is compiled when the container starts."""
    for path in (root / HOME).rglob("*"):
        os.utime(path, (EPOCH, EPOCH), follow_symlinks=False)
    within(root, f"/{HOME}/bin/python", "-m", "compileall", "-q", "-j2", f"/{HOME}/lib")
    for folder in ("etc/hilserver", "var/lib/hilserver", "var/cache/hilserver"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    shutil.copy(
        Path(__file__).with_name("config.yaml"), root / "etc/hilserver/config.yaml"
    )
    shutil.copy(Path(__file__).parents[1] / "objects.py", root / "run")
    within(root, f"/{HOME}/bin/python", "/run/objects.py", f"/{OBJECTS}")
    # a daemon may run beside the build
    (root / "run/any_port.yaml").write_text(ANY_PORT)
    within(
        root,
        f"/{HOME}/bin/hilserver",
        "run",
        "-c",
        "/run/any_port.yaml",
        "--duration",
        "2",
    )
    for folder in WITHOUT:
        for path in (root / folder).iterdir() if (root / folder).exists() else ():
            if path != root / "var/cache/hilserver":
                run("rm", "-rf", path)
    with (root / "etc/passwd").open("a") as users:
        users.write(
            f"hilserver:x:{USER_ID}:{USER_ID}::/var/lib/hilserver:/usr/sbin/nologin\n"
        )
    with (root / "etc/group").open("a") as groups:
        groups.write(f"hilserver:x:{USER_ID}:\n")
    for folder in ("var/lib/hilserver", "var/cache/hilserver"):
        run("chown", "-R", f"{USER_ID}:{USER_ID}", root / folder)
        run("chmod", "-R", "go-w", root / folder)


# --- OCI image specification 1.0 ------------------------------------------------------------------


def write_image(root: Path, out: Path, version: str) -> None:
    """Write the file system as an archive of an OCI layout with one layer."""
    blobs = out.with_suffix(".blobs")
    shutil.rmtree(blobs, ignore_errors=True)
    blobs.mkdir()
    layer, diff_id = write_layer(root, blobs)
    config = add_json(blobs, "config", configuration(diff_id, version))
    manifest = add_json(blobs, "manifest", {
        "schemaVersion": 2,
        "mediaType": "application/vnd.oci.image.manifest.v1+json",
        "config": config,
        "layers": [layer],
    })  # fmt: skip
    names = {"org.opencontainers.image.ref.name": f"localhost/hilserver:{version}"}
    index = {"schemaVersion": 2, "manifests": [manifest | {"annotations": names}]}
    (blobs / "index.json").write_text(json.dumps(index))
    (blobs / "oci-layout").write_text('{"imageLayoutVersion": "1.0.0"}')
    with tarfile.open(out, "w") as archive:
        for path in sorted(blobs.iterdir()):
            is_blob = len(path.name) == 64
            archive.add(
                path,
                f"blobs/sha256/{path.name}" if is_blob else path.name,
                filter=plain,
            )
    shutil.rmtree(blobs)


def configuration(diff_id: str, version: str) -> dict[str, object]:
    """Return how a container of the image starts."""
    labels = {"org.opencontainers.image.title": "hilserver",
              "org.opencontainers.image.version": version,
              "org.opencontainers.image.licenses": "MIT"}  # fmt: skip
    return {
        "architecture": PLATFORM[platform.machine()][0],
        "os": "linux",
        "config": {
            "User": f"{USER_ID}:{USER_ID}",
            "Env": [f"{name}={value}" for name, value in ENVIRONMENT.items()],
            "Entrypoint": [f"/{HOME}/bin/hilserver"],
            "Cmd": ["run", "-c", "/etc/hilserver/config.yaml"],
            "WorkingDir": "/var/lib/hilserver",
            "Volumes": {f"/var/{kind}/hilserver": {} for kind in ("lib", "cache")},
            "StopSignal": "SIGTERM",
            "Labels": labels,
        },
        "rootfs": {"type": "layers", "diff_ids": [diff_id]},
    }


def write_layer(root: Path, blobs: Path) -> tuple[dict[str, object], str]:
    """Write the only layer; return its descriptor, and the digest of what it unpacks to."""
    packed, unpacked = blobs / "layer.gz", blobs / "layer"
    with tarfile.open(unpacked, "w", format=tarfile.PAX_FORMAT) as archive:
        for path in [root, *sorted(root.rglob("*"))]:
            archive.add(
                path, str(path.relative_to(root)), recursive=False, filter=plain
            )
    diff_id = digest_of(unpacked)
    with (
        unpacked.open("rb") as source,
        packed.open("wb") as target,
        gzip.GzipFile(
            filename="", mode="wb", fileobj=target, compresslevel=3, mtime=0
        ) as out,
    ):
        shutil.copyfileobj(source, out, 1 << 20)
    unpacked.unlink()
    return add(packed, "layer.v1.tar+gzip"), f"sha256:{diff_id}"


def plain(member: tarfile.TarInfo) -> tarfile.TarInfo:
    """Return a member without what differs from one build to the next."""
    member.uname = member.gname = ""
    member.mtime = EPOCH
    return member


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as source:
        return hashlib.file_digest(source, "sha256").hexdigest()


def add(path: Path, kind: str) -> dict[str, object]:
    """Name a file by its digest; return its descriptor."""
    digest, size = digest_of(path), path.stat().st_size
    path.rename(path.with_name(digest))
    media = f"application/vnd.oci.image.{kind}"
    return {"mediaType": media, "digest": f"sha256:{digest}", "size": size}


def add_json(blobs: Path, kind: str, content: object) -> dict[str, object]:
    """Add a document."""
    path = blobs / kind
    path.write_text(json.dumps(content, sort_keys=True))
    return add(path, f"{kind}.v1+json")


if __name__ == "__main__":
    sys.exit(main())
