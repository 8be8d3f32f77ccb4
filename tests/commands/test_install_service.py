"""The unit that install-service writes, and where it refuses to."""

import re
import resource
from pathlib import Path

import pytest

from hilserver.commands.install_service import File, _write, check_reachable, plan
from hilserver.errors import FailedError
from tests.commands.test_cli import hilserver

PYTHON, CONFIG = Path("/opt/h/.venv/bin/python"), Path("/etc/hilserver/config.yaml")


def unit_of(*words: object) -> str:
    [unit] = [
        file.text for file in plan(*words) if file.path.name == "hilserver.service"
    ]
    return unit


def test_the_unit_names_this_computers_interpreter_configuration_and_user() -> None:
    unit = unit_of(PYTHON, Path("/etc/my robot/50%.yaml"), "robot", "read-only")
    command = '/opt/h/.venv/bin/python -m hilserver run -c "/etc/my robot/50%%.yaml"'
    assert f"\nExecStart={command}\n" in unit
    assert "\nUser=robot\n" in unit
    assert "\nProtectHome=read-only\n" in unit


def test_the_shipped_unit_is_what_a_default_installation_gets() -> None:
    shipped = Path(__file__).parents[2] / "deploy" / "systemd" / "hilserver.service"
    default = unit_of(Path("/opt/hilserver/.venv/bin/python"), CONFIG, "hilserver")
    assert default == shipped.read_text(encoding="utf-8")


def test_an_existing_configuration_is_kept() -> None:
    [config] = [
        file for file in plan(PYTHON, CONFIG, "hilserver") if file.path == CONFIG
    ]
    assert config.keep


def test_a_full_disk_leaves_the_unit_of_before(tmp_path: Path) -> None:
    """A limit for the size of files, in place of a full disk."""
    unit = tmp_path / "hilserver.service"
    unit.write_text("before\n")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(FailedError, match="cannot write"):
            _write(File(unit, "x" * 100_000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert {path: path.read_text() for path in tmp_path.iterdir()} == {unit: "before\n"}


def test_places_that_a_service_cannot_see_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FailedError, match="hidden from services"):
        check_reachable([Path("/tmp/venv/bin/python")])
    assert check_reachable([Path("/usr/bin/env")]) == "yes"
    assert check_reachable([Path("/home/somebody/venv/bin/python")]) == "read-only"


def test_a_closed_folder_on_the_way_is_named(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("hilserver.commands.install_service._HIDDEN", ())
    for folder in (tmp_path, tmp_path.parent, tmp_path.parent.parent):
        folder.chmod(0o755)
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o700)
    with pytest.raises(FailedError, match=re.escape(str(closed))):
        check_reachable([closed / "bin" / "python"])


def test_dry_run_prints_and_writes_nothing(tmp_path: Path) -> None:
    run = hilserver(
        "install-service", "--dry-run", "--user-name", "robot", cwd=tmp_path
    )
    assert run.returncode == 0, run.stderr
    assert "# --- /etc/systemd/system/hilserver.service" in run.stdout
    assert "User=robot" in run.stdout


def test_root_is_no_user_for_it(tmp_path: Path) -> None:
    run = hilserver("install-service", "--dry-run", "--user-name", "root", cwd=tmp_path)
    assert run.returncode == 2
    assert "unprivileged" in run.stderr
