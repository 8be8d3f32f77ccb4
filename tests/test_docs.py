"""The documents: every link leads somewhere, and the first screen shows the two commands."""

import re
import shlex
import textwrap
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from hilserver import commands
from hilserver.io.link_status import PeerStatus
from hilserver.io.peer_link import metrics as peer_metrics
from hilserver.metrics import MetricKind

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    page
    for place in ("*.md", "docs/**/*.md", "examples/**/*.md", "deploy/**/*.md")
    for page in ROOT.glob(place)
    if "node_modules" not in page.parts
)
COMMAND_LINE = re.compile(
    r" *(?:\$ )?(?:sudo )?(?:\.venv/bin/)?hilserver (?!is )(\w.*)"
)
WORD = re.compile(r"\w+")
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)")
LINK_TO = re.compile(r"\]\((?!https?:|opc\.tcp:)([^)\s]+)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_relative_link_leads_to_a_file(page: Path) -> None:
    links = LINK.findall(page.read_text(encoding="utf-8"))
    local = [
        link for link in links if not link.startswith(("http:", "https:", "opc.tcp:"))
    ]
    missing = [link for link in local if not (page.parent / link).exists()]
    assert not missing


def test_readme_shows_picture_commands_and_result_on_its_first_screen() -> None:
    first_screen = "\n".join(
        (ROOT / "README.md").read_text(encoding="utf-8").splitlines()[:24]
    )
    for shown in (
        "](docs/overview.svg)",
        "\n$ make run",
        "\n$ make test",
        "opc.tcp://127.0.0.1",
    ):
        assert shown in first_screen


def figures_of_the_readme() -> list[str]:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return (
        text.split("<!-- figures: begin -->")[1]
        .split("<!-- figures: end -->")[0]
        .splitlines()
    )


def test_readme_has_a_row_for_every_command() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    table = text.split("\n## Commands\n\n")[1].split("\n\n")[0]
    rows = re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE)
    named = {
        word for row in rows for word in re.findall(r"`(?:hilserver )?(.+?)`", row)
    }
    assert named == set(commands.COMMANDS)


def test_figures_of_the_readme_stand_in_one_line_cells() -> None:
    cells = [cell.strip() for row in figures_of_the_readme() for cell in row.split("|")]
    assert not [cell for cell in cells if len(cell) > 55]


def test_every_figure_of_the_readme_has_a_command_that_the_program_takes() -> None:
    lines = re.findall(
        r"`(bench .+?)` \|$", "\n".join(figures_of_the_readme()), re.MULTILINE
    )
    assert len(lines) > 20
    assert all(commands._parse(shlex.split(line)) for line in set(lines))


def test_every_page_of_the_docs_can_be_reached_from_the_index() -> None:
    start = ROOT / "docs" / "index.md"
    reached, waiting = {start}, [start]
    while waiting:
        page = waiting.pop()
        for link in LINK.findall(page.read_text(encoding="utf-8")):
            target = (page.parent / link).resolve()
            if target.suffix == ".md" and target.exists() and target not in reached:
                reached.add(target)
                waiting.append(target)
    assert set(ROOT.glob("docs/**/*.md")) <= reached


def test_the_map_in_contributing_names_every_folder_once_in_the_order_of_the_layers() -> (
    None
):
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    drawn = re.findall(r"^  (\w+)/ ", text, flags=re.MULTILINE)
    assert sorted(drawn) == sorted(
        p.parent.name for p in ROOT.glob("hilserver/*/__init__.py")
    )
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    layers = contract["tool"]["importlinter"]["contracts"][0]["layers"]
    height = {
        room: place
        for place, layer in enumerate(layers)
        for room in WORD.findall(layer)
    }
    heights = [height[room] for room in drawn]
    assert heights == sorted(heights)


def test_root_modules_are_those_of_the_map() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    drawn = set(re.findall(r"(\w+\.py)  ", text.split("```")[3]))
    assert drawn == {path.name for path in ROOT.glob("hilserver/*.py")} - {
        "__init__.py"
    }


def command_lines() -> Iterator[tuple[str, str]]:
    """Give page and words of every `hilserver ...` line in a block of code, fenced or indented."""
    for page in PAGES:
        is_fenced = False
        for line in page.read_text("utf-8").splitlines():
            is_fenced ^= line.lstrip().startswith("```")
            match = COMMAND_LINE.match(line)
            if match and (is_fenced or line.startswith("    ")):
                yield str(page.relative_to(ROOT)), match[1]


@pytest.mark.parametrize(("page", "line"), list(command_lines()))
def test_every_command_line_is_one_that_the_program_takes(page: str, line: str) -> None:
    words = [
        word for word in shlex.split(line, comments=True) if word not in ("...", "&&")
    ]
    assert commands._parse(words), page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_module_and_test_that_is_named_exists(page: Path) -> None:
    named = re.findall(
        r"\b(?:hilserver|tests)/[\w/]+\.py\b", page.read_text(encoding="utf-8")
    )
    assert not [name for name in named if not (ROOT / name).exists()]


def test_the_example_of_a_metric_is_a_counter_of_peers() -> None:
    text = (ROOT / "docs/how-to/extend.md").read_text(encoding="utf-8")
    [example] = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    metric = eval(textwrap.dedent(example), vars(peer_metrics))
    assert metric.kind is MetricKind.COUNTER
    [(labels, reading)] = metric.read([PeerStatus("plc", writes=3)])
    assert (*labels, *reading.counts) == ("plc", 3)
