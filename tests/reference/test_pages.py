"""The pages that are made from the code say what the code says."""

import importlib
import re

import pytest

from hilserver.core import handover, transitions
from hilserver.daemon.metrics import METRICS
from reference import FOLDER, PAGES, control, states


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_up_to_date(name):
    assert (FOLDER / name).read_text(encoding="utf-8") == PAGES[name](), (
        "run 'make reference'"
    )


def test_every_key_of_the_configuration_is_described():
    for line in PAGES["configuration.md"]().splitlines():
        if line.startswith("| `"):
            assert not line.endswith("|  |"), line


def test_every_metric_has_a_row():
    lines = PAGES["metrics.md"]().splitlines()
    rows = [line.split("`")[1] for line in lines if line.startswith("| `hil_")]
    assert rows == [metric.name for metric in METRICS]


def test_every_function_on_a_set_points_way_stands_in_the_file_that_is_named():
    found = 0
    for names, path in re.findall(
        r"((?:`[\w.]+`(?:, )?)+) in `([\w/]+)\.py`", PAGES["step.md"]()
    ):
        module = importlib.import_module(f"hilserver.{path.replace('/', '.')}")
        for name in re.findall(r"`(\w+)", names):
            assert hasattr(module, name), f"{name} in {path}.py"
            found += 1
    assert found >= 17


def test_every_command_and_every_event_has_its_meaning():
    assert set(states.MEANING) == set(transitions.TRANSITIONS)
    assert set(control.MEANING) == set(handover.TABLE)
