"""Who drives: the table is complete, the gate obeys it."""

import pytest

from hilserver.core import handover
from hilserver.core.events import EventBus
from hilserver.core.handover import Happening, Next, Standing
from hilserver.errors import ControlRefused
from tests.core.test_control import World
from tests.fakes import make_gate, make_image, make_table

OWNERS = {Standing.ITSELF: "opcua", Standing.ABOVE: "peer", Standing.BELOW: "page"}
ASKED = {Happening.TAKE: "opcua", Happening.GIVE: "ros2", Happening.RELEASE: "nobody"}


def test_every_event_has_a_row():
    assert set(handover.TABLE) == set(Happening)
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


STAYS = ("pause", "stop", "reset")
"""Commands of the state machine, after each of which the same source has control."""


def test_no_command_of_the_state_machine_moves_control(tmp_path):
    world = World(tmp_path)
    try:
        for name in STAYS:
            getattr(world.control, name)()
            world.latch()
            assert world.gate.owner == "opcua"
    finally:
        world.image.close()
    for happening in set(Happening) - set(ASKED) - {Happening.COMMAND, Happening.GONE}:
        assert set(handover.TABLE[happening]) == {Next.SAME}


@pytest.mark.parametrize("standing", Standing)
def test_a_command_and_a_departure_follow_the_table(standing, tmp_path):
    world = World(tmp_path)
    try:
        world.gate.take(OWNERS[standing], holder := object())
        refused = world.gate.write("opcua", {"twist.linear_m_s": 0.1})
        following = handover.next_driver(Happening.COMMAND, standing)
        assert bool(refused) == (following is Next.REFUSED)
        before = world.gate.owner
        world.gate.gone(holder if standing is Standing.ITSELF else object())
        following = handover.next_driver(Happening.GONE, standing)
        assert world.gate.owner == ("nobody" if following is Next.FALLBACK else before)
    finally:
        world.image.close()
