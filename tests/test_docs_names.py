"""What the documents name exists: headings, files, options, targets, keys, versions."""

import argparse
import importlib.util
import json
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import yaml

from hilserver import __version__, commands
from hilserver.signals import Ranges, robot_table
from tests.test_docs import LINK_TO, PAGES, ROOT

BLOCK = re.compile(r"^ *```(\w*)\n(.*?)^ *```", re.S | re.M)
SPAN = re.compile(r"`([^`\n]+)`")
PATH = re.compile(
    r"(?<![\w/.-])(?:docs|deploy|examples|tests|hilserver|benchmarks|reference|page|\.ci)/[\w./*-]*"
)
KEY = re.compile(r"[a-z_0-9]+(?:\[\])?(?:\.[a-z_0-9]+(?:\[\])?)+")
SCHEMA = json.loads((ROOT / "config.schema.json").read_text("utf-8"))
CODE = "".join(p.read_text("utf-8") for p in ROOT.glob("hilserver/**/*.py"))
SIGNAL = re.compile(r"[a-z]\w*(?:\.\w+)+")
NOT_SIGNALS = (".py", ".yaml", ".csv", ".md", ".mcap", ".tum", ".kitti")
FILES = (".jsonl", ".mcap", ".py")
NOT_FILES = {"hilserver/msg/Frame"}  # a ROS type


def wrong(names: Callable[[Path], Iterable[str]]) -> dict[str, list[str]]:
    """Return what does not exist, by the page that names it."""
    found = {str(page.relative_to(ROOT)): list(names(page)) for page in PAGES}
    return {page: names for page, names in found.items() if names}


def prose(page: Path) -> str:
    return BLOCK.sub("", page.read_text("utf-8"))


def spans(page: Path) -> list[str]:
    return SPAN.findall(prose(page))


def slugs(page: Path) -> set[str]:
    heads = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def test_every_place_within_a_page_is_a_heading() -> None:
    def missing(page: Path) -> Iterator[str]:
        for link in LINK_TO.findall(page.read_text("utf-8")):
            to, _, at = link.partition("#")
            target = page.parent / to if to else page
            if at and target.suffix == ".md" and at not in slugs(target):
                yield link

    assert not wrong(missing)


def test_every_file_that_is_named_exists() -> None:
    def missing(page: Path) -> Iterator[str]:
        for path in {
            path for span in spans(page) for path in PATH.findall(span)
        } - NOT_FILES:
            if not any(ROOT.glob(path.rstrip("/."))):
                yield path

    assert not wrong(missing)


def below(node: dict) -> dict:
    """Return the part of the schema that describes a value, whatever stands around it."""
    while True:
        if "$ref" in node:
            node = SCHEMA["$defs"][node["$ref"].rpartition("/")[2]]
        elif "anyOf" in node:
            node = next(part for part in node["anyOf"] if part.get("type") != "null")
        elif "items" in node:
            node = node["items"]
        else:
            return node


def unknown(node: dict, value: object) -> Iterator[str]:
    """Yield the keys of a value that the schema does not have."""
    node = below(node)
    if isinstance(value, list):
        for item in value:
            yield from unknown(node, item)
    elif isinstance(value, dict) and "properties" in node:
        for key, item in value.items():
            if key in node["properties"]:
                yield from unknown(node["properties"][key], item)
            else:
                yield key


def nested(path: str) -> object:
    value: object = None
    for key in reversed(path.replace("[]", "").split(".")):
        value = {key: value}
    return value


def test_every_key_of_the_configuration_that_is_named_exists() -> None:
    """A name that begins as a key does may be a signal, a fault, a figure of a peer, or a file."""

    def missing(page: Path) -> Iterator[str]:
        for span in spans(page):
            match = KEY.fullmatch(span.partition(":")[0])
            if match is None or re.split(r"[.\[]", span)[0] not in SCHEMA["properties"]:
                continue
            key = match[0]
            is_other = (
                key.startswith(("shield.", "peers."))
                or key.endswith(FILES)
                or key in CODE
            )
            if not is_other and any(unknown(SCHEMA, nested(key))):
                yield key

    assert not wrong(missing)


def test_every_key_in_an_example_of_a_configuration_exists() -> None:
    def missing(page: Path) -> Iterator[str]:
        for kind, text in BLOCK.findall(page.read_text("utf-8")):
            given = yaml.safe_load(textwrap.dedent(text)) if kind == "yaml" else None
            if not isinstance(given, dict) or "channels" in given:  # of a mapping
                continue
            if given.keys() & SCHEMA["properties"].keys():
                yield from unknown(SCHEMA, given)

    assert not wrong(missing)


def test_every_signal_that_is_named_exists() -> None:
    table = robot_table(Ranges(1.0, 1.0, 1.0, 1.0), body=True, observer=True)
    names = {signal.name for signal in table}
    kinds = {name.partition(".")[0] for name in names} - set(SCHEMA["properties"])

    def missing(page: Path) -> Iterator[str]:
        for span in spans(page):
            is_name = SIGNAL.fullmatch(span) and not span.endswith(NOT_SIGNALS)
            # or is a group
            exists = any(f"{name}_".startswith(f"{span}_") for name in names)
            if is_name and span.partition(".")[0] in kinds and not exists:
                yield span

    assert not wrong(missing)


def options(parser: argparse.ArgumentParser) -> set[str]:
    """Return all options of a command and of those below it."""
    if hasattr(parser, "load"):  # a bench
        parser.load()
    found = set(parser._option_string_actions)
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            found |= {
                option for sub in action.choices.values() for option in options(sub)
            }
    return found


def test_every_command_in_a_sentence_has_its_options() -> None:
    def missing(page: Path) -> Iterator[str]:
        for span in spans(page):
            program, name, *words = [*re.split(r"[\s=,]+", span), "", ""]
            if program != "hilserver" or not name[:1].islower():
                continue
            parser = argparse.ArgumentParser()
            if name in commands.COMMANDS:
                commands._module(name).add_arguments(parser)
            asked = {word for word in words if word.startswith("--")}
            if name not in commands.COMMANDS or not asked <= options(parser):
                yield span

    assert not wrong(missing)


def test_every_make_target_and_module_that_is_named_exists() -> None:
    rules = re.findall(
        r"^([a-z-]+(?: [a-z-]+)*):", (ROOT / "Makefile").read_text("utf-8"), re.M
    )
    targets = {target for rule in rules for target in rule.split()}

    def missing(page: Path) -> Iterator[str]:
        text = page.read_text("utf-8")
        yield from {*re.findall(r"(?:`|^\$ |^# )make ([a-z-]+)", text, re.M)} - targets
        for name in re.findall(
            r"python -m ((?:hilserver|benchmarks|reference|tests)[\w.]*)", text
        ):
            if importlib.util.find_spec(name.rstrip(".")) is None:
                yield name

    assert not wrong(missing)


def test_the_newest_release_of_the_changelog_is_the_version() -> None:
    released = re.findall(
        r"^## (\d+\.\d+\.\d+) - ", (ROOT / "CHANGELOG.md").read_text(), re.M
    )
    assert released[0] == __version__


def test_images_are_named_by_the_version() -> None:
    pages = [
        ROOT / "deploy" / "container" / "compose.yaml",
        ROOT / "docs/how-to/container.md",
    ]
    tags = [
        tag
        for p in pages
        for tag in re.findall(r"localhost/hilserver:([\w.]+)", p.read_text())
    ]
    assert {*tags} == {__version__}
