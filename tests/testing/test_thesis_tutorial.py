"""Every command of the tutorial about the thesis, in its order, in a copy of its folder."""

import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hilserver.commands import main
from tests.helpers.daemons import free_port
from tests.io.ros2.rig import claimed_domain
from tests.testing.test_tune_tutorial import ALONE

DOCS = Path(__file__).parents[2] / "docs" / "tutorial"
TEXT = (DOCS / "thesis.md").read_text(encoding="utf-8")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    shutil.copytree(DOCS / "thesis", tmp_path, dirs_exist_ok=True)
    with (tmp_path / "sil.yaml").open("a", encoding="utf-8") as file:
        file.write(ALONE.format(port=free_port()))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def commands():
    """The words of what a reader types after the preparation."""
    blocks = re.findall(r"```console\n(.*?)```", TEXT, re.DOTALL)
    lines = [line[2:].split() for block in blocks for line in block.splitlines()]
    return [words for words in lines if words[0] not in ("cd", "export")]


def test_every_command_does_what_the_page_says(folder, monkeypatch, capsys):
    *first, (_, *start), (python, program) = commands()
    assert [words[1] for words in first] == ["check", *["experiment"] * 3]
    for _, *words in first:
        assert main(words) == 0
    said = capsys.readouterr().out
    assert "K_om 1.955" in said
    assert "5.6.2   out a little" in said
    assert re.search(r"K_om by \(5\.19\), all samples: 1\.95", said)
    assert re.search(r"T1: 121\.\d ms", said)
    for report, figure in (("turns", "5.8"), ("circle", "5.52")):
        page = (folder / report / "report.html").read_text()
        assert f"(figure {figure}" in page
    assert 'class="line extended"' in page

    # chapter 6: the daemon in one terminal, the key in another
    assert (start, python) == (["run", "-c", "sil.yaml"], "python")
    with claimed_domain() as domain, (folder / "run.log").open("wb") as log:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        daemon = subprocess.Popen(
            [sys.executable, "-m", "hilserver", *start], stdout=log, stderr=log
        )
        try:
            words = [sys.executable, program]
            pressed = subprocess.run(
                words, capture_output=True, text=True, timeout=600, check=False
            )
        finally:
            daemon.send_signal(signal.SIGINT)
            daemon.wait(600)
    assert pressed.returncode == 0, pressed.stderr
    shown = re.search(r"```\n(no key.*?)```", TEXT, re.DOTALL)[1]
    assert pressed.stdout.count(shown) == 3
    assert re.search(r"^S: -?0\.0 rpm$", pressed.stdout, re.M)
