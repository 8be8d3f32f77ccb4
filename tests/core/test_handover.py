"""Who drives: the table is complete, the gate obeys it, the page shows it."""

from pathlib import Path

import pytest

from hilserver.core import handover
from hilserver.core.events import EventBus
from hilserver.core.handover import Happening, Next, Standing
from hilserver.errors import ControlRefused
from tests.fakes import make_gate, make_image, make_table

PAGE = Path(__file__).parents[2] / "docs/reference/control.md"
OWNERS = {Standing.ITSELF: "opcua", Standing.ABOVE: "peer", Standing.BELOW: "page"}
ASKED = {Happening.TAKE: "opcua", Happening.GIVE: "ros2", Happening.RELEASE: "nobody"}


def test_every_event_has_a_row_and_a_meaning():
    assert set(handover.TABLE) == set(handover.MEANING) == set(Happening)
    assert all(len(row) == len(Standing) for row in handover.TABLE.values())


@pytest.mark.parametrize("standing", Standing)
@pytest.mark.parametrize("happening", ASKED)
def test_the_gate_obeys_the_table(happening, standing):
    table = make_table()
    image = make_image(table)
    try:
        owner = OWNERS[standing]
        gate = make_gate(table, image, EventBus(), owner=owner)
        following = handover.next_driver(happening, standing)
        if following is Next.REFUSED:
            with pytest.raises(ControlRefused, match=f"'{owner}' has control"):
                gate.request("opcua", ASKED[happening])
        else:
            gate.request("opcua", ASKED[happening])
        after = {Next.TAKER: "opcua", Next.NAMED: "ros2", Next.FALLBACK: "nobody"}
        assert gate.owner == after.get(following, owner)
    finally:
        image.close()


def test_the_page_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == handover.as_markdown()
