"""The page of the four ways: every function that it names is there, and so is every call."""

import ast
import re
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "explanation" / "ways.md"
ROW = re.compile(r"^\| `(hilserver/[\w/]+\.py)`(?: `([\w.]+)`)? \|.*\| (.*) \|$")


class Place(NamedTuple):
    """A step: the file, what in it, and how it is reached."""

    way: str
    file: str
    name: str
    reached: str

    @property
    def id(self):
        return f"{self.way}-{Path(self.file).stem}-{self.name or 'file'}"


def steps():
    way = ""
    for line in PAGE.read_text().splitlines():
        if line.startswith("## "):
            way = line.removeprefix("## ").split(",")[0].replace(" ", "_")
        elif found := ROW.match(line):
            yield Place(way, found[1], found[2] or "", found[3])


STEPS = list(steps())
CALLS = [
    (one, other)
    for one, other in pairwise(STEPS)
    if one.way == other.way and other.reached == "calls"
]


CALLED_BY = [
    (step, caller[1])
    for step in STEPS
    if (caller := re.match(r"called by `(\w+)`", step.reached))
]


def definition(place):
    """Return the syntax tree of a function, or of a whole file."""
    node = ast.parse((ROOT / place.file).read_text())
    for word in filter(None, place.name.split(".")):
        inside = {getattr(child, "name", None): child for child in node.body}
        assert word in inside, f"{place.file} has no {place.name}"
        node = inside[word]
    return node


def names_in(node):
    names = {child.id for child in ast.walk(node) if isinstance(child, ast.Name)}
    return names | {
        child.attr for child in ast.walk(node) if isinstance(child, ast.Attribute)
    }


def test_the_steps_are_counted():
    said = re.findall(
        r"^\| \[(.*?)\]\(#.*?\) \| (\d+) \|$", PAGE.read_text(), re.MULTILINE
    )
    counted = Counter(step.way.replace("_", " ") for step in STEPS)
    assert {way: int(number) for way, number in said} == counted
    assert len(counted) == 4


@pytest.mark.parametrize("place", STEPS, ids=lambda place: place.id)
def test_each_place_is_there(place):
    definition(place)


@pytest.mark.parametrize(("caller", "called"), CALLS, ids=lambda place: place.id)
def test_each_call_is_made(caller, called):
    assert called.name.split(".")[-1] in names_in(definition(caller))


@pytest.mark.parametrize(("called", "by"), CALLED_BY, ids=str)
def test_each_caller_calls(called, by):
    callers = [step for step in STEPS if step.name.split(".")[-1] == by]
    wanted = called.name.split(".")[-1]
    assert any(wanted in names_in(definition(caller)) for caller in callers)
