"""Benches that are not installed: where they are found, and what is said where they are not."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import hilserver
from benchmarks import BENCHES
from hilserver import commands
from hilserver.commands.bench import ELSEWHERE

ROOT = Path(hilserver.__file__).parents[1]
MAIN = "import sys; from hilserver.commands import main; sys.exit(main(sys.argv[1:]))"


def python(*words, folder, path):
    command = [sys.executable, *words]
    environment = os.environ | {"PYTHONPATH": str(path)}
    return subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_those_that_are_named_elsewhere_are_those_of_the_checkout():
    assert sorted(ELSEWHERE) == sorted(set(BENCHES) - {"jitter"})


@pytest.mark.parametrize("words", [("-c", MAIN, "bench"), ("-m", "benchmarks")])
def test_a_checkout_has_them_all_under_both_commands(words):
    """One that imports little stands for all."""
    injector = ROOT / "tests" / "injector"
    shown = python(*words, "start", "--help", folder=ROOT, path=injector)
    assert shown.returncode == 0, shown.stderr
    assert "--cold" in shown.stdout


def test_an_installed_package_says_where_they_are(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        hilserver, "__file__", str(tmp_path / "hilserver" / "__init__.py")
    )
    for words in (("attack",), ("diagnose", "--seeds", "3", "-h")):
        assert commands.main(["bench", *words]) == 1
        assert capsys.readouterr().err.splitlines() == [
            f"hilserver: 'bench {words[0]}' compares with other programs and is not installed"
            f" with hilserver; run 'python -m benchmarks {words[0]}' in a checkout of its source"
        ]
    with pytest.raises(SystemExit):
        commands.main(["bench", "jitter", "--help"])
    assert "--with" not in capsys.readouterr().out


def test_every_figure_of_the_readme_has_a_command_that_is_taken():
    rows = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    lines = [
        found[1] for row in rows if (found := re.search(r"\| `(bench [^`]*)` \|$", row))
    ]
    assert len(lines) > 15
    for line in dict.fromkeys(lines):
        commands._parse(shlex.split(line))
