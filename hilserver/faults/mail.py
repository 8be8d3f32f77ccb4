"""The way of commands into the compiled step, and the look at what acts there."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hilserver.faults.plan import Entry
from hilserver.image import ProcessImage
from hilserver.kernel import modifier_layout as lay
from hilserver.kernel.modifier_layout import Kind
from hilserver.kernel.modifier_mail import show_mail


@dataclass(frozen=True, slots=True)
class Acting:
    """One modifier as the arena holds it; `has_begun` once it has acted."""

    number: int
    kind: Kind
    slot: int
    from_tick: int
    until_tick: int
    has_begun: bool


@dataclass(frozen=True, slots=True)
class Command:
    """One command: `operation` on the entries `number`, or a new entry."""

    operation: int
    number: int = 0
    entry: Entry | None = None


class Mailbox:
    """Producer of the mail, reader of the table; belongs to the event loop's thread."""

    def __init__(self, image: ProcessImage) -> None:
        self._image = image
        self._mail_values, self._mail = image.region("modifier_mail")
        self._table_values, self._table = image.region("modifiers")

    @property
    def head(self) -> int:
        """Commands sent so far."""
        return self._image.control.mail_head

    @property
    def tail(self) -> int:
        """Commands that the step has taken."""
        return self._image.control.mail_tail

    @property
    def timed_rows(self) -> int:
        """Timed input rows pushed so far."""
        return self._image.control.timed_head

    @property
    def waiting(self) -> int:
        """Commands sent and not yet taken."""
        return self.head - self.tail

    def send(self, commands: Sequence[Command]) -> None:
        """Hand over commands; one tick takes all of them.

        Raises
        ------
        ValueError
            If the step has no room for them now.
        """
        if len(commands) > lay.MAIL_ROWS - self.waiting:
            raise ValueError(f"{len(commands)} commands are too many at once; try again")
        head = self.head
        for offset, command in enumerate(commands):
            self._write(((head + offset) & (lay.MAIL_ROWS - 1)) * lay.MAIL_ROW, command)
        show_mail(head + len(commands), self._image.words)

    def _write(self, row: int, command: Command) -> None:
        words, values = self._mail, self._mail_values
        words[row] = command.operation
        row += 1
        words[row + lay.E_ID] = command.number
        entry = command.entry
        if entry is None:
            return
        for place, number in (
            (lay.E_KIND, int(entry.kind)),
            (lay.E_SLOT, entry.slot),
            (lay.E_OTHER, entry.other),
            (lay.E_SIDE, entry.side),
            (lay.E_FROM, entry.from_tick),
            (lay.E_UNTIL, entry.until_tick),
            (lay.E_SEED, entry.seed),
            (lay.E_EVERY, entry.every),
            (lay.E_TICKS, entry.ticks),
            (lay.E_SPREAD, entry.spread),
            (lay.E_INTEGER, int(entry.is_integer)),
            (lay.E_CHANNEL, entry.channel),
        ):
            words[row + place] = number
        for place, value in (
            (lay.E_A, entry.a),
            (lay.E_B, entry.b),
            (lay.E_C, entry.c),
            (lay.E_LOW, entry.low),
            (lay.E_HIGH, entry.high),
        ):
            values[row + place] = value

    def acting(self) -> list[Acting]:
        """Return the modifiers in the arena; between two ticks it is exact."""
        table = self._table.copy()
        found: list[Acting] = []
        for i in range(min(int(table[lay.H_COUNT]), lay.MAX_MODIFIERS)):
            entry = table[lay.ENTRIES + i * lay.N_ENTRY :]
            kind = int(entry[lay.E_KIND])
            if kind in set(Kind):
                found.append(
                    Acting(
                        int(entry[lay.E_ID]),
                        Kind(kind),
                        int(entry[lay.E_SLOT]),
                        int(entry[lay.E_FROM]),
                        int(entry[lay.E_UNTIL]),
                        bool(entry[lay.E_START] >= 0),
                    )
                )
        return found

    @property
    def timeouts(self) -> int:
        """How often the command time-out has fired."""
        return int(self._table[lay.H_TIMEOUTS])

    @property
    def is_silent(self) -> bool:
        """Whether the command time-out holds the set-points at zero."""
        return bool(self._table[lay.H_SILENT])


def rings_of(entries: Iterable[Entry]) -> int:
    """Return how many delay rings the entries need."""
    return sum(entry.kind in lay.RING_KINDS for entry in entries)
