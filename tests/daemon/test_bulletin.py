"""What the board says: of events, a flood of overruns hides nothing; of who drives."""

import time
from types import SimpleNamespace

from asyncua import Client, ua

from hilserver.core.events import Event, EventBus, EventKind
from hilserver.daemon.assembly import assemble
from hilserver.daemon.bulletin import Surroundings
from hilserver.daemon.daemon import Daemon
from hilserver.image.board import BoardReader
from tests.commands.test_cli import write_config
from tests.loopback.rig import wait_until


def test_the_overruns_of_a_slice_are_one_line():
    bus = EventBus(lambda: 1.25)
    bus.publish(Event(EventKind.STATE, 200, "daemon", "the operator asked for a stop"))
    for number in range(1000):
        bus.publish(Event(EventKind.OVERRUN, 400, "plant", f"late wake {number}"))
    bus.publish(Event(EventKind.OVERRUN, 400, "sensors", "long run"))
    shown = Surroundings._events(SimpleNamespace(core=SimpleNamespace(events=bus)))
    assert {event["simulated_s"] for event in shown} == {1.25}
    # the time is shown to the millisecond, which may round it up
    ages_s = [time.monotonic() - event["monotonic_s"] for event in shown]
    assert all(-0.001 <= age_s < 60 for age_s in ages_s)
    assert [(event["source"], event["count"]) for event in shown] == [
        ("sensors", 1),
        ("plant", 255),
        ("daemon", 1),
    ]
    assert shown[1]["text"] == "late wake 999"


async def test_an_opcua_client_drives_from_its_first_command_until_it_leaves(tmp_path):
    async with Daemon(assemble(write_config(tmp_path))) as daemon:
        board = BoardReader(daemon.image)

        def shown():
            daemon._notice._due_s = 0.0
            daemon._notice.show()
            return board.content["owner"], board.content["opcua_wrote"]

        assert shown() == ("opcua", False)
        async with Client(daemon.part("opcua").address) as client:
            namespace = await client.get_namespace_index("urn:hilserver:robot")
            node = client.get_node(f"ns={namespace};s=twist.linear_m_s")
            await node.read_value()
            assert shown() == ("opcua", False)
            await node.write_value(0.1, ua.VariantType.Double)
            assert shown() == ("opcua", True)
        await wait_until(lambda: shown() == ("opcua", False))
