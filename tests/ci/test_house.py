"""The numbers of the house, on a small one."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

HOUSE = Path(__file__).parents[2] / ".ci" / "house.py"
CELLAR = '''"""The cellar."""

DEPTH_M = 2
_OWN = 3


def dig():
    # Because of the frost.
    return DEPTH_M
'''
ATTIC = '''"""The attic."""

from hilserver.cellar.floor import (
    P_DEPTH,
    dig,
)

DEPTH_M = 4.0
_OWN = 5
'''


@pytest.fixture
def house(tmp_path: Path) -> Path:
    for name, text in {"cellar/floor": CELLAR, "attic/roof": ATTIC, "shed/door": ""}.items():
        path = tmp_path / "hilserver" / f"{name}.py"
        path.parent.mkdir(parents=True)
        path.write_text(text)
    return tmp_path


def run(house: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, HOUSE, "--root", house, "--baseline", house / "house.json", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )


def test_it_counts_what_it_says(house: Path) -> None:
    assert run(house, "--write").returncode == 0
    assert json.loads((house / "house.json").read_text())["numbers"] == {
        "lines": 13,
        "files": 3,
        "functions_over_50_lines": 0,
        "names_with_two_values": 1,  # a private name is of its module alone
        "room_pairs_joined_percent": 33.3,
        "index_import_lines": 1,
        "comments_percent": 7.69,
    }


def test_a_number_gets_worse_only_with_a_reason(house: Path) -> None:
    run(house, "--write")
    assert run(house, "--check").returncode == 0
    long = "def long():\n" + "    print()\n" * 50
    (house / "hilserver" / "shed" / "door.py").write_text(long)
    checked = run(house, "--check")
    assert checked.returncode == 1
    assert "lines is 64, it was 13" in checked.stderr
    assert "functions_over_50_lines is 1, it was 0" in checked.stderr
    assert "comments_percent is 1.56, it was 7.69" in checked.stderr
    assert "files" not in checked.stderr
    assert run(house, "--write").returncode == 1
    assert run(house, "--write", "--reason", "a door").returncode == 0
    assert json.loads((house / "house.json").read_text())["reason"] == "a door"
    assert run(house, "--check").returncode == 0


def test_what_gets_better_passes(house: Path) -> None:
    run(house, "--write")
    (house / "hilserver" / "attic" / "roof.py").unlink()
    assert run(house, "--check").returncode == 0
    assert "lines                                6        13" in run(house).stdout
