"""docs/reference/step.md shows the step that is generated, and names functions that exist."""

import importlib
import re
from pathlib import Path

from hilserver.daemon.step_reference import markdown

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "step.md"


def test_the_page_is_the_one_that_make_reference_writes() -> None:
    assert PAGE.read_text(encoding="utf-8") == markdown(), "run 'make reference'"


def test_every_function_on_a_set_points_way_stands_in_the_file_that_is_named() -> None:
    found = 0
    for names, path in re.findall(r"((?:`[\w.]+`(?:, )?)+) in `([\w/]+)\.py`", markdown()):
        module = importlib.import_module(f"hilserver.{path.replace('/', '.')}")
        for name in re.findall(r"`(\w+)", names):
            assert hasattr(module, name), f"{name} in {path}.py"
            found += 1
    assert found >= 17
