"""The unit as text: how exposed it is, and what must not stand in it."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

UNIT = Path(__file__).parents[2] / "deploy" / "systemd" / "hilserver.service"
EXPOSURE_MAX = 1.5


def exposure(path: Path) -> float:
    if shutil.which("systemd-analyze") is None:
        pytest.fail(
            "systemd-analyze is missing: 'apt-get install systemd'", pytrace=False
        )
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", str(path)],
        capture_output=True,
        text=True,
        timeout=600,
        check=True,
    )
    found = re.search(r"Overall exposure level for \S+: ([\d.]+)", done.stdout)
    assert found, done.stdout
    return float(found[1])


def test_the_unit_is_hardly_exposed(tmp_path: Path) -> None:
    assert exposure(UNIT) <= EXPOSURE_MAX
    bare = tmp_path / "bare.service"
    bare.write_text("[Service]\nExecStart=/bin/true\n")
    assert exposure(bare) > 9


def test_nothing_takes_the_real_time_rights_away() -> None:
    keys = dict(re.findall(r"(?m)^([A-Z]\w+)=(.*)$", UNIT.read_text(encoding="utf-8")))
    forbidden = {"CPUWeight", "CPUQuota", "CPUAccounting", "CPUSchedulingPolicy"}
    assert not forbidden & keys.keys()
    assert "RestrictRealtime" not in keys
    assert "MemoryDenyWriteExecute" not in keys
    assert int(keys["LimitRTPRIO"]) >= 80
    assert keys["LimitMEMLOCK"] == "infinity"
    assert "78" in keys["RestartPreventExitStatus"].split()


def test_memory_is_limited_and_a_child_that_is_killed_for_it_ends_no_plant() -> None:
    """Without OOMPolicy a diagnosis of the page that is too large would stop the whole service."""
    keys = dict(re.findall(r"(?m)^([A-Z]\w+)=(.*)$", UNIT.read_text(encoding="utf-8")))
    assert re.fullmatch(r"[1-4]G", keys["MemoryMax"])
    assert keys["OOMPolicy"] == "continue"
