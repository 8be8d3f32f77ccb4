"""The files of numbers that decide: every number has its meaning, and a use."""

import ast
from pathlib import Path

import pytest

import hilserver
from hilserver.diagnosis import thresholds as of_diagnosis
from hilserver.measured import thresholds as of_measured


@pytest.fixture(scope="module")
def used():
    """Every name that a file reads which knows thresholds, or that is one of them."""
    found = set()
    for path in Path(hilserver.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if "thresholds" in text:
            names = (n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Name))
            found |= {n.id for n in names if isinstance(n.ctx, ast.Load)}
    return found


@pytest.mark.parametrize(
    "module", [of_diagnosis, of_measured], ids=lambda one: one.__name__
)
def test_every_number_has_a_meaning_and_a_use(module, used):
    text = Path(module.__file__).read_text(encoding="utf-8")
    lines = ["", *text.splitlines()]
    numbers = {
        s.target.id: (s.lineno, s.end_lineno)
        for s in ast.parse(text).body
        if isinstance(s, ast.AnnAssign)
    }
    assert len(numbers) > 10
    for name, (first, last) in numbers.items():
        beside = "#" in "".join(lines[first : last + 1])
        assert beside or lines[first - 1].startswith("# "), f"no word on {name}"
    assert not set(numbers) - used, "nobody uses them"
