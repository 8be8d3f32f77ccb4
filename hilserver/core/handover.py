"""Who drives, as a table: which source has control after an event, or that it is refused.

`HandOver` looks up requests in it; tests compare the other rows with gate and state machine.
``docs/reference/control.md`` prints it. What the wheels receive meanwhile is up to the step.
"""

from collections.abc import Iterable, Mapping, Sequence
from enum import StrEnum
from typing import Any, Final

from hilserver.core.events import Event, EventBus, EventKind
from hilserver.core.leases import NOBODY, OFFERING, Leases, kind_of
from hilserver.errors import ControlRefused
from hilserver.image import ProcessImage, Row
from hilserver.plant.layout import N_SETPOINTS


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


_DEPARTED: Final = object()
"""In place of a client that has left, until its control is passed on or its set-points end."""
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


class HandOver:
    """Keeps one kind of source in control, and hands control over.

    Parameters
    ----------
    owner : str
        Kind of source that commands at the start, one of `SOURCES`.
    priority : sequence of str
        Kinds of sources, highest priority first; those left out may not command.
    fallback : str
        Who has control when its holder is gone: ``nobody``, or the source ``before``.

    Attributes
    ----------
    owner : str
        Kind of source that has control, or ``nobody``.
    may_fall_back : bool
        Set to False by whatever ends a command; True again when control is taken.
    present : set
        Clients of our OPC UA server that have commanded and are still there.
    """

    def __init__(
        self,
        image: ProcessImage,
        events: EventBus,
        leases: Leases,
        owner: str,
        priority: Sequence[str],
        fallback: str,
    ) -> None:
        self.owner = owner
        self.leases = leases
        self.priority = tuple(priority)
        self.may_fall_back = True
        self.present: set[object] = set()
        # client that wrote each set-point last: the value ends with it; None: it stays
        self._writers: dict[int, object] = {}
        # set-points of clients that have left, not yet zero
        self._left: set[int] = set()
        leases.begin(owner)
        self._image = image
        self._events = events
        self._fallback = fallback
        self._before = NOBODY
        self._speaker = ""
        self._holder: object = None

    @property
    def holder(self) -> Any:
        """Client of our OPC UA server that has taken control and is still there, or None."""
        return None if self._holder is _DEPARTED else self._holder

    def take(self, kind: str, holder: object = None) -> None:
        """Give control to the sources of `kind`, or to nobody.

        Parameters
        ----------
        holder : object
            Client that holds it; control is passed on when it is `gone`.

        Raises
        ------
        ControlRefused
            If `kind` is unknown, or the queue of inputs is full.
        """
        self.expect_take(kind, holder)
        if (kind, holder) == (self.owner, self._holder):
            return
        self._image.push([self.leases.hand_over(kind)])
        before = self.owner
        self.owner = kind
        self._holder = holder
        self._speaker = ""
        self._writers.clear()
        self._left.clear()
        if kind != before:
            self._before = before
            self.may_fall_back = True
            text = f"control passes from '{before}' to '{kind}'"
            self._events.publish(Event(EventKind.STATE, 300, kind, text))

    def expect_take(self, kind: str, holder: object = None) -> None:
        """Raise ControlRefused if `take` would; nothing changes."""
        if kind not in (*self.priority, NOBODY):
            known = ", ".join(self.priority)
            raise ControlRefused(f"'{kind}' cannot take control; sources are {known}")
        words = self._image.control
        is_full = words.now_head - words.now_tail >= words.now_capacity
        if is_full and (kind, holder) != (self.owner, self._holder):
            raise ControlRefused("the input queue is full: try again")

    def request(self, requester: str, kind: str, holder: object = None) -> None:
        """Let `requester` hand control to `kind`, if it may; "nobody" gives it back.

        Raises
        ------
        ControlRefused
            If the present owner outranks the requester.
        """
        happening = Happening.TAKE if kind == requester else Happening.GIVE
        if kind == NOBODY:
            happening = Happening.RELEASE
        following = next_driver(happening, self._standing(requester))
        if following is Next.REFUSED:
            none = f": '{requester}' has no control to give back"
            why = none if kind == NOBODY else f" and outranks '{requester}'"
            raise ControlRefused(f"'{self.owner}' has control{why}")
        if following is Next.FALLBACK:
            self._fall_back("gives control back")
        else:
            self.take(kind, holder if kind == requester else None)

    def _standing(self, kind: str) -> Standing:
        if kind == self.owner:
            return Standing.ITSELF
        order = self.priority
        owner = self.owner
        is_above = kind in order and (
            owner not in order or order.index(kind) <= order.index(owner)
        )
        return Standing.ABOVE if is_above else Standing.BELOW

    def gone(self, client: object) -> None:
        """Note that a client has left: pass on the control it held, or end its set-points."""
        self.present.discard(client)
        if client is None:
            return
        if client is self._holder:
            self._holder = _DEPARTED
        self._left |= {
            slot for slot, writer in self._writers.items() if writer is client
        }
        self.end_departed()

    def commanded(self, slots: Iterable[int], client: object) -> None:
        """Note which client of our OPC UA server has set these set-points; None: they stay."""
        for slot in slots:
            self._writers[slot] = client
            self._left.discard(slot)

    def end_departed(self) -> bool:
        """Do what the departure of a client asks for and is not done yet.

        Returns
        -------
        bool
            False if the queue of inputs is full: then it remains to be done.
        """
        if self._holder is _DEPARTED:
            try:
                self._fall_back("is gone")
            except ControlRefused:
                return False
        elif self._left:
            rows = [
                Row(self.leases.place(self.owner, slot), 0.0)
                for slot in sorted(self._left)
            ]
            if not self._image.push(rows):
                return False
            for slot in self._left:
                del self._writers[slot]
            self._left.clear()
            text = f"a client of '{self.owner}' is gone: its set-points are zero"
            self._events.publish(Event(EventKind.STATE, 500, self.owner, text))
        return True

    def _fall_back(self, why: str) -> None:
        gone = self.owner
        before = self._before
        kind = before if self._fallback == "before" and self.may_fall_back else NOBODY
        self.take(kind)
        who = "nobody drives" if kind == NOBODY else f"'{kind}' drives again"
        event = Event(EventKind.STATE, 500, gone, f"'{gone}' {why}: {who}")
        self._events.publish(event)

    def _passed_on(self, source: str, rows: list[Row]) -> list[Row]:
        """Return rows that end the commands of another source of this kind: two never mix."""
        kind = kind_of(source)
        is_driving = kind == self.owner and any(row.slot < N_SETPOINTS for row in rows)
        if kind in OFFERING or not is_driving:
            return []
        before = self._speaker
        self._speaker = source
        if before in ("", source):
            return []
        return [self.leases.hand_over(kind)]
