"""docs/reference/metrics.md says what the code does."""

from pathlib import Path

from hilserver.daemon.metrics import METRICS
from hilserver.daemon.metrics_reference import markdown

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "metrics.md"


def test_the_page_is_the_one_that_make_reference_writes() -> None:
    assert PAGE.read_text(encoding="utf-8") == markdown(), "run 'make reference'"


def test_every_metric_has_a_row() -> None:
    rows = [line.split("`")[1] for line in markdown().splitlines() if line.startswith("| `hil_")]
    assert rows == [metric.name for metric in METRICS]
