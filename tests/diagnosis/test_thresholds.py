"""The files of numbers that decide: every number has its meaning, and a use."""

import ast
from pathlib import Path

import pytest

import hilserver
from hilserver.diagnosis import thresholds as of_diagnosis
from hilserver.measured import thresholds as of_measured

ROOM = {of_diagnosis: "diagnosis", of_measured: "measured"}


@pytest.mark.parametrize("module", ROOM, ids=ROOM.values())
def test_every_number_has_a_meaning_and_a_use(module):
    text = Path(module.__file__).read_text(encoding="utf-8")
    lines = ["", *text.splitlines()]
    numbers = {s.target.id: s.lineno for s in ast.parse(text).body if isinstance(s, ast.AnnAssign)}
    assert len(numbers) > 10
    for name, at in numbers.items():
        assert "#" in lines[at] or lines[at - 1].startswith("# "), f"no word on {name}"
    used = set()
    for path in (Path(hilserver.__file__).parent / ROOM[module]).rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        loads = (n for n in ast.walk(tree) if isinstance(n, ast.Name))
        used |= {n.id for n in loads if isinstance(n.ctx, ast.Load)}
    assert not set(numbers) - used, "nobody uses them"
