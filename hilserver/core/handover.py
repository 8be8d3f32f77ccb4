"""Who drives as a table: which source has control after an event, or that it is refused.

`InputGate` looks up what was asked; that the other rows hold, too, is tested against gate and state
machine. ``docs/reference/control.md`` prints it. What the wheels get
meanwhile is the step's business.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Final


class Happening(StrEnum):
    """What may move control, or end what is commanded."""

    TAKE = "take"
    GIVE = "give"
    RELEASE = "release"
    COMMAND = "command"
    GONE = "gone"
    LAPSE = "lapse"
    STOP = "Stop"
    RESET = "Reset"
    PAUSE = "Pause"
    LOAD = "LoadSnapshot"


class Next(StrEnum):
    """Who has control afterwards."""

    SAME = "as before"
    TAKER = "who asks"
    NAMED = "who is named"
    FALLBACK = "control.fallback"
    REFUSED = "-"


class Standing(StrEnum):
    """How the source that asks stands to the one that has control."""

    ITSELF = "has control itself"
    ABOVE = "is above, or nobody drives"
    BELOW = "is below in control.priority"


_SAME, _TAKER, _NAMED, _FALLBACK, _REFUSED = Next

# fmt: off
TABLE: Final[Mapping[Happening, tuple[Next, Next, Next]]] = {
    # the source:        itself     above      below
    Happening.TAKE:     (_SAME,     _TAKER,    _REFUSED),
    Happening.GIVE:     (_NAMED,    _NAMED,    _REFUSED),
    Happening.RELEASE:  (_FALLBACK, _REFUSED,  _REFUSED),
    Happening.COMMAND:  (_SAME,     _REFUSED,  _REFUSED),
    Happening.GONE:     (_FALLBACK, _SAME,     _SAME),
    Happening.LAPSE:    (_SAME,     _SAME,     _SAME),
    Happening.STOP:     (_SAME,     _SAME,     _SAME),
    Happening.RESET:    (_SAME,     _SAME,     _SAME),
    Happening.PAUSE:    (_SAME,     _SAME,     _SAME),
    Happening.LOAD:     (_SAME,     _SAME,     _SAME),
}
# fmt: on


def next_driver(happening: Happening, standing: Standing) -> Next:
    """Return who has control after something has happened."""
    return TABLE[happening][tuple(Standing).index(standing)]
