"""A container with systemd as process 1, in which the tests install and drive the service.

The file system is made once with debootstrap and kept (``HILSERVER_TEST_CACHE``, else
``~/.cache/hilserver-test``). Every boot lays a volatile layer over it: nothing a test does stays.
The interpreter, its packages and this repository are mounted into it read-only: below /opt, because
a hardened service sees neither /home nor /root. The cache of compiled kernels is kept, too.
"""

import contextlib
import fcntl
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
PACKAGES = "systemd,systemd-sysv,dbus,python3,python3-venv"
BOOT_LIMIT_S = 60
PYTHON = "/opt/hilserver/.venv/bin/python"


def missing() -> str:
    """Return in one sentence what is not there; empty when all is."""
    if os.geteuid() != 0:
        return "the systemd tests boot a container, which needs root"
    for tool, package in (
        ("debootstrap", "debootstrap"),
        ("systemd-nspawn", "systemd-container"),
    ):
        if shutil.which(tool) is None:
            return f"{tool} is not installed: 'apt-get install {package}' (make test does it)"
    return ""


def cache_folder() -> Path:
    given = os.environ.get("HILSERVER_TEST_CACHE")
    return Path(given) if given else Path.home() / ".cache" / "hilserver-test"


def root_file_system() -> Path:
    """Return the container's file system; made if there is none (a minute or two)."""
    suite = platform.freedesktop_os_release().get("VERSION_CODENAME", "bookworm")
    folder = cache_folder() / f"systemd-{suite}"
    if folder.exists():
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = folder.with_suffix(".partial")
    shutil.rmtree(partial, ignore_errors=True)
    subprocess.run(
        [
            "debootstrap",
            "--variant=minbase",
            f"--include={PACKAGES}",
            suite,
            str(partial),
        ],
        check=True,
        stdout=subprocess.DEVNULL,
        timeout=900,
    )
    shutil.rmtree(partial / "var/cache/apt/archives", ignore_errors=True)
    partial.rename(folder)
    return folder


@contextlib.contextmanager
def one_at_a_time() -> Iterator[None]:
    """Two containers would share the control group of their payload."""
    cache_folder().mkdir(parents=True, exist_ok=True)
    with (cache_folder() / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


class Container:
    """A booted container; commands run in it as root."""

    def __init__(self, folder: Path, log: Path) -> None:
        self._log = log
        python = Path(sys.base_prefix)
        site_packages = Path(np.__file__).parents[1]
        binds = {
            site_packages: "/opt/hilserver/packages",
            ROOT: "/opt/hilserver/source",
        }
        self._python = Path(f"/usr/bin/python3.{sys.version_info.minor}")
        if python != Path("/usr"):
            binds[python] = "/opt/python"
            self._python = Path(f"/opt/python/bin/python3.{sys.version_info.minor}")
        kernels = cache_folder() / "kernels"
        kernels.mkdir(exist_ok=True)
        with log.open("wb") as out:
            self._nspawn = subprocess.Popen(
                [
                    "systemd-nspawn",
                    f"--directory={folder}",
                    f"--machine=hilserver-{os.getpid()}",
                    "--volatile=overlay",
                    "--boot",
                    "--register=no",
                    "--keep-unit",
                    "--private-network",
                    "--link-journal=no",
                    "--resolv-conf=off",
                    "--timezone=off",
                    "--console=pipe",
                    "--capability=CAP_IPC_LOCK",
                    f"--bind={kernels}:/var/cache/private/hilserver",
                    *(f"--bind-ro={here}:{there}" for here, there in binds.items()),
                ],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
            )
        try:
            self._init = self._find_init()
            wait_until(self._is_up, BOOT_LIMIT_S, "the container boots")
            self._make_environment()
        except BaseException:
            self.stop()
            raise

    def _find_init(self) -> int:
        children = Path(f"/proc/{self._nspawn.pid}/task/{self._nspawn.pid}/children")

        def found() -> bool:
            assert self._nspawn.poll() is None, self._log.read_text(errors="replace")
            return any(
                Path(f"/proc/{pid}/comm").read_text().strip() == "systemd"
                for pid in children.read_text().split()
            )

        wait_until(found, BOOT_LIMIT_S, "systemd becomes process 1")
        return int(children.read_text().split()[0])

    def _is_up(self) -> bool:
        return self.run("systemctl", "is-system-running").stdout.strip() in (
            "running",
            "degraded",
        )

    def _make_environment(self) -> None:
        venv = self.path("/opt/hilserver/.venv")
        packages = venv / f"lib/python3.{sys.version_info.minor}/site-packages"
        packages.mkdir(parents=True)
        (venv / "bin").mkdir()
        (venv / "bin/python").symlink_to(self._python)
        (venv / "pyvenv.cfg").write_text(f"home = {self._python.parent}\n")
        # A Python built as a shared library finds it by an absolute path that is not there.
        self.path("/etc/ld.so.conf.d/python.conf").write_text("/opt/python/lib\n")
        self.check("ldconfig")
        (packages / "hilserver.pth").write_text(
            "/opt/hilserver/source\n/opt/hilserver/packages\n"
        )

    def path(self, inside: str) -> Path:
        """Return the host's path of a file in the container."""
        return Path(f"/proc/{self._init}/root{inside}")

    def run(
        self, *words: str, timeout_s: float = 60
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [
                "nsenter",
                "-t",
                str(self._init),
                "-m",
                "-u",
                "-i",
                "-n",
                "-p",
                "--",
                *words,
            ],
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
            env={"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "LC_ALL": "C.UTF-8"},
        )

    def check(self, *words: str, timeout_s: float = 60) -> str:
        done = self.run(*words, timeout_s=timeout_s)
        assert done.returncode == 0, f"{' '.join(words)}: {done.stdout}{done.stderr}"
        return done.stdout

    def show(self, unit: str, key: str) -> str:
        return self.check(
            "systemctl", "show", unit, f"--property={key}", "--value"
        ).strip()

    def journal(self, unit: str, since: str = "") -> str:
        after = [f"--after-cursor={since}"] if since else []
        return self.run(
            "journalctl", "-u", unit, "-o", "cat", "--no-pager", *after
        ).stdout

    def cursor(self) -> str:
        """Return where the journal stands now."""
        text = self.check("journalctl", "-n", "0", "--show-cursor")
        return text.rpartition("-- cursor: ")[2].strip()

    def pid_here(self, pid_inside: int) -> int:
        """Return the host's number of a process of the container."""
        for status in Path("/proc").glob("[0-9]*/status"):
            with contextlib.suppress(OSError):
                for line in status.read_text().splitlines():
                    if line.startswith("NSpid:") and line.split()[2:] == [
                        str(pid_inside)
                    ]:
                        return int(status.parent.name)
        raise AssertionError(f"process {pid_inside} of the container is not there")

    def stop(self) -> None:
        """Halt; kill what does not."""
        self._nspawn.terminate()
        try:
            self._nspawn.wait(600)
        except subprocess.TimeoutExpired:
            self._nspawn.kill()
            self._nspawn.wait(600)


def wait_until(condition: Callable[[], object], limit_s: float, what: str) -> float:
    """Return how long it took [s]."""
    started_s = time.monotonic()
    while not condition():
        assert time.monotonic() - started_s < limit_s, f"not within {limit_s} s: {what}"
        time.sleep(0.05)
    return time.monotonic() - started_s
