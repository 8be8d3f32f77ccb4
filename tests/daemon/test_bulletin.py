"""What the board says of events: a flood of overruns hides nothing."""

from types import SimpleNamespace

from hilserver.core.events import Event, EventBus, EventKind
from hilserver.daemon.bulletin import Surroundings


def test_the_overruns_of_a_slice_are_one_line():
    bus = EventBus()
    bus.publish(Event(EventKind.STATE, 200, "daemon", "the operator asked for a stop"))
    for number in range(1000):
        bus.publish(Event(EventKind.OVERRUN, 400, "plant", f"late wake {number}"))
    bus.publish(Event(EventKind.OVERRUN, 400, "sensors", "long run"))
    shown = Surroundings._events(SimpleNamespace(core=SimpleNamespace(events=bus)))
    assert [(event["source"], event["count"]) for event in shown] == [
        ("sensors", 1),
        ("plant", 255),
        ("daemon", 1),
    ]
    assert shown[1]["text"] == "late wake 999"
