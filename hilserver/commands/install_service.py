"""Install the daemon as a systemd service of this computer (needs root).

Writes the unit, a group and a udev rule for the latency target, and a configuration where there is
none. Nothing is started.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from hilserver.errors import EXIT_DONE, FailedError
from hilserver.program.whole_file import write_whole

EXAMPLE = "hilserver install-service --dry-run"

_USER = re.compile(r"[a-z_][a-z0-9_-]{0,30}")
_HIDDEN = ("/tmp", "/var/tmp", "/dev/shm")  # noqa: S108 (PrivateTmp= and the like hide them)
_FIRST_CONFIGURATION = """\
# hilserver as a service; a key that is left out has its default (docs/reference/configuration.md).
snapshots:
  folder: /var/lib/hilserver/snapshots   # StateDirectory= of the unit
"""


@dataclass(frozen=True)
class File:
    """A file to be written; `keep`: only where there is none."""

    path: Path
    text: str
    mode: int = 0o644
    keep: bool = False


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--user-name``, ``--config``, ``--dry-run``."""
    parser.add_argument(
        "--user-name",
        type=_user_name,
        default="hilserver",
        metavar="NAME",
        help="user that runs the service; if there is none, it is created while the service runs"
        " (default: hilserver)",
    )
    parser.add_argument(
        "-c",
        "--config",
        type=Path,
        default=Path("/etc/hilserver/config.yaml"),
        metavar="FILE",
        help="configuration of the service (default: /etc/hilserver/config.yaml)",
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="print what would be written and exit"
    )


def _user_name(text: str) -> str:
    if not _USER.fullmatch(text) or text == "root":
        raise argparse.ArgumentTypeError(
            f"'{text}' is not a name for an unprivileged user"
        )
    return text


def run(args: argparse.Namespace) -> int:
    """Install; return 0, or fail with one sentence."""
    python = Path(sys.executable)
    config = args.config.absolute()
    protect_home = "yes"
    try:
        protect_home = check_reachable(
            [python, Path(sys.base_prefix), _package(), config]
        )
    except FailedError as error:
        if not args.dry_run:
            raise
        print(f"hilserver: the installation would fail: {error}", file=sys.stderr)
    files = plan(python, config, args.user_name, protect_home)
    if args.dry_run:
        for file in files:
            print(
                f"# --- {file.path}{' (only if it does not exist)' if file.keep else ''}"
            )
            print(file.text)
        return EXIT_DONE
    if os.geteuid() != 0:
        raise FailedError(
            "install-service writes to /etc: run it with sudo, or with --dry-run"
        )
    for file in files:
        _write(file)
    path = Path("/etc/hilserver/credentials")
    path.mkdir(parents=True, exist_ok=True)
    path.chmod(0o700)
    _tell_system()
    print(
        f"installed; edit {config}, check it with 'hilserver check -c {config}', then"
    )
    print("  systemctl enable --now hilserver")
    return EXIT_DONE


def plan(
    python: Path, config: Path, user: str, protect_home: str = "yes"
) -> list[File]:
    """Return the files of the service, with the values of this computer filled in."""
    folder = _templates()
    unit = (folder / "hilserver.service").read_text(encoding="utf-8")
    settings = {
        "ExecStart": f"{_quoted(python)} -m hilserver run -c {_quoted(config)}",
        "User": user,
        "ProtectHome": protect_home,
    }
    for key, value in settings.items():
        line = f"{key}={value}".replace("\\", r"\\")
        unit, count = re.subn(rf"(?m)^{key}=.*$", line, unit)
        if count != 1:
            raise FailedError(
                f"{folder / 'hilserver.service'}: {key}= occurs {count} times"
            )
    rules = (folder / "60-hilserver.rules").read_text(encoding="utf-8")
    group = (folder / "hilserver.sysusers").read_text(encoding="utf-8")
    return [
        File(Path("/etc/systemd/system/hilserver.service"), unit),
        File(Path("/etc/udev/rules.d/60-hilserver.rules"), rules),
        File(Path("/etc/sysusers.d/hilserver.conf"), group),
        File(config, _FIRST_CONFIGURATION, keep=True),
    ]


def check_reachable(paths: list[Path]) -> str:
    """Return the value of ProtectHome= with which an unprivileged service reaches `paths`.

    FailedError if it cannot reach one of them at all.
    """
    protect_home = "yes"
    for path in paths:
        for place in {path, path.resolve()}:
            if any(place.is_relative_to(hidden) for hidden in _HIDDEN):
                raise FailedError(
                    f"{place} is hidden from services; install into /opt/hilserver"
                )
            for parent in place.parents:
                if parent.exists() and not parent.stat().st_mode & 0o001:
                    raise FailedError(
                        f"{parent}, above {place}, is not accessible to other users; install"
                        " hilserver (and its Python) into /opt/hilserver"
                    )
            if any(
                place.is_relative_to(home) for home in ("/home", "/root", "/run/user")
            ):
                protect_home = "read-only"
    return protect_home


def _package() -> Path:
    return Path(__file__).resolve().parents[1]


def _templates() -> Path:
    """Return the folder of the unit: in the repository, or where the wheel puts it."""
    for root in (
        _package().parent / "deploy",
        Path(sys.prefix) / "share" / "hilserver",
    ):
        if (root / "systemd" / "hilserver.service").exists():
            return root / "systemd"
    raise FailedError(
        "the unit hilserver.service is not part of this installation; reinstall it"
    )


def _quoted(path: Path) -> str:
    text = str(path).replace("%", "%%").replace("$", "$$")
    return f'"{text}"' if " " in text else text


def _write(file: File) -> None:
    if file.keep and file.path.exists():
        print(f"kept     {file.path}")
        return
    try:
        file.path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file.path, file.text.encode())
        file.path.chmod(file.mode)
    except OSError as error:
        what = (error.strerror or "not writable").lower()
        raise FailedError(f"cannot write {file.path}: {what}") from None
    print(f"written  {file.path}")


def _tell_system() -> None:
    """Make the group, apply the udev rule, let systemd read the unit, where this is possible."""
    for command in (
        ("systemd-sysusers", "/etc/sysusers.d/hilserver.conf"),
        ("udevadm", "control", "--reload"),
        ("udevadm", "trigger", "--action=change", "/dev/cpu_dma_latency"),
        ("systemctl", "daemon-reload"),
    ):
        program = shutil.which(command[0])
        if program is None:
            print(f"skipped '{' '.join(command)}': {command[0]} is not installed")
            continue
        result = subprocess.run(  # noqa: S603 (fixed words)
            [program, *command[1:]],
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        if result.returncode != 0:
            reason = (result.stderr or result.stdout).strip().splitlines()
            print(
                f"'{' '.join(command)}' failed: {reason[-1] if reason else 'no reason given'}"
            )
