"""The commands of the how-to, word for word: each version that was there comes back."""

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.systemd.container import PYTHON, ROOT
from tests.systemd.service import UNIT, Service
from tests.systemd.versions import VERSIONS, git, make_repository

pytestmark = [pytest.mark.systemd, pytest.mark.long]

PAGE = (ROOT / "docs/how-to/systemd.md").read_text(encoding="utf-8")
UPGRADE, BACK = re.findall(
    r"```console\n\$ (.*?)```", PAGE.split("## Upgrade")[1], re.DOTALL
)[:2]
CLONE = re.compile(r"sudo git clone --branch (\S+) (\S+) (\S+)")
PRELUDE = """
export PIP_NO_INDEX=1 PIP_NO_DEPS=1 PYTHONPATH=/opt/hilserver/packages
sudo() { "$@"; }
python3() { "$PYTHON" "$@"; }
"""
"""Nothing can be downloaded there; what hilserver needs is mounted, for the service, too."""


class Computer:
    """The installed service, and the repository that the commands name."""

    def __init__(self, service: Service, repository: Path) -> None:
        self.service, self.repository = service, repository

    def do(self, commands: str, version: str) -> subprocess.CompletedProcess[str]:
        """Carry out a block of the page."""
        text = commands.replace("<version>", version)
        text = text.replace("<this repository>", str(self.repository))
        container = self.service.container
        if (clone := CLONE.search(text)) is not None:
            text = text.replace(
                clone[0], "true" if self._clone(*clone.groups()) else "false"
            )
        python = container.run("readlink", "-f", PYTHON).stdout.strip()
        script = f"PYTHON={python}\n{PRELUDE}{text}"
        return container.run("/bin/sh", "-c", script, timeout_s=600)

    def _clone(self, tag: str, repository: str, target: str) -> bool:
        """Clone on the host, as the container has no git; like it, into no folder that is there."""
        where = self.service.container.path(target)
        with tempfile.TemporaryDirectory() as folder:
            clone = f"{folder}/clone"
            words = ["git", "clone", "--quiet", "--branch", tag, repository, clone]
            done = subprocess.run(words, capture_output=True, timeout=300, check=False)
            if done.returncode != 0 or where.exists():
                return False
            shutil.copytree(clone, where)
        return True

    @property
    def version(self) -> str:
        """What the running daemon says of itself."""
        found = re.search(
            r'hil_build_info{.*version="([^"]+)"', self.service.get("/metrics")[1]
        )
        assert found
        return f"v{found[1].partition('.')[0]}"


@pytest.fixture(scope="module")
def computer(
    installed: Service, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Computer]:
    container = installed.container
    folder = container.path(f"/etc/systemd/system/{UNIT}.d")
    folder.mkdir()
    drop_in = folder / "packages.conf"
    drop_in.write_text("[Service]\nEnvironment=PYTHONPATH=/opt/hilserver/packages\n")
    yield Computer(
        installed, make_repository(tmp_path_factory.mktemp("repository") / "it")
    )
    drop_in.unlink()
    folder.rmdir()
    Service.install(container)
    installed.stop()


def test_two_upgrades_and_two_roll_backs(computer: Computer) -> None:
    """Before, the second upgrade laid .venv into .venv.before, and v3 went back to v1."""
    for version in VERSIONS:
        done = computer.do(UPGRADE, version)
        assert done.returncode == 0, done.stdout + done.stderr
        assert computer.version == version
    for version in ("v2", "v1", "v3"):
        done = computer.do(BACK, version)
        assert done.returncode == 0, done.stdout + done.stderr
        assert computer.version == version


def test_an_upgrade_that_fails_says_so_and_leaves_the_service_alone(
    computer: Computer,
) -> None:
    computer.do(UPGRADE, "v1")  # unless the other test has done it
    assert computer.do(BACK, "v1").returncode == 0
    pid = computer.service.main_pid

    assert computer.do(UPGRADE, "v9").returncode != 0, "there is none of that number"
    assert computer.do(UPGRADE, "v1").returncode != 0, "its folder is there"
    assert computer.do(BACK, "v8").returncode != 0, "it was never installed"

    git(computer.repository, "checkout", "--quiet", "-b", "v4", "v2")
    (computer.repository / "backend.py").write_text(
        "raise SystemExit(1)\n", encoding="utf-8"
    )
    git(computer.repository, "commit", "--quiet", "--all", "--message=v4")
    assert computer.do(UPGRADE, "v4").returncode != 0, "pip cannot install it"
    assert (computer.service.main_pid, computer.version) == (pid, "v1")
