"""Every source and every event, against a real daemon: what the wheels get, and who drives."""

from pathlib import Path

import pytest

from tests.control import table
from tests.control.clients import RefusedError
from tests.control.robot import running_robot
from tests.control.stage import Stage

PAGE = Path(__file__).parents[2] / "docs/reference/control-matrix.md"


@pytest.fixture(scope="module")
def stage(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("control")
    with running_robot(folder, **table.VARIANTS[request.param]) as robot:
        stage = Stage(robot)
        yield stage
        stage.forget()


def ids(cell):
    return f"{cell[0]}-{cell[1]}".replace(" ", "_")


def thin():
    """One cell of every event, with another source each: what every test run has time for."""
    for number, event in enumerate(table.EVENTS):
        row = [cell for cell in table.cells() if cell[0] == event]
        yield row[3 * number % len(row)]


THIN = frozenset(thin())
CELLS = [
    pytest.param(
        table.parts(cell[0])[1],
        cell,
        id=ids(cell),
        marks=[] if cell in THIN else pytest.mark.long,
    )
    for cell in table.cells()
]


@pytest.mark.parametrize(("stage", "cell"), CELLS, indirect=["stage"], scope="module")
def test_cell(stage, cell):
    event, source, outcome = table.parts(cell[0])[0], *cell[1:]
    stage.begin(source)
    try:
        if outcome == "refused":
            head, at_ns = stage.eye.head, 0
            with pytest.raises(RefusedError):
                stage.happen(event, source)
        else:
            head, at_ns = stage.happen(event, source)
        stage.check(event, source, outcome, head, at_ns)
    finally:
        if event in ("cut", "silent"):
            stage.forget(source)


def test_the_page_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == table.as_markdown()
