"""A whole daemon whose cache cannot be used starts, and says so in one line."""

import json
import shutil

import pytest

from hilserver.cache import spare_folder
from hilserver.compiled.cache import shelf
from tests.helpers.daemons import running_daemon


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """Compile what the daemon needs, unless that is done; return the folder of this version."""
    with running_daemon(tmp_path_factory.mktemp("warm")) as daemon:
        assert daemon.stop() == 0
    return shelf().folder


def test_a_daemon_without_its_cache_uses_the_spare_one_and_says_one_line(
    compiled, tmp_path, monkeypatch
):
    (tmp_path / "a_file").touch()
    monkeypatch.setenv("HILSERVER_CACHE_DIR", str(tmp_path / "a_file"))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    spare_folder().mkdir(mode=0o700)
    shutil.copytree(compiled, spare_folder() / compiled.name)
    with running_daemon(tmp_path) as daemon:
        assert daemon.stop() == 0
    lines = [
        json.loads(line) for line in (tmp_path / "daemon.log").read_text().splitlines()
    ]
    [told] = [line for line in lines if "HILSERVER_CACHE_DIR" in line["event"]]
    assert told["level"] == "warning"
    assert told["event"].startswith(
        f"{tmp_path}/a_file: not a directory; compiled code is kept in"
    )
    assert not any("compiling" in line["event"] for line in lines)
    assert list((spare_folder() / "opcua").iterdir())
