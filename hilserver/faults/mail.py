"""How commands get into the compiled step, and what acts there is read."""

from collections.abc import Sequence
from dataclasses import dataclass

from hilserver.image import ProcessImage
from hilserver.kernel import modifier_layout as lay
from hilserver.kernel.modifier_layout import Kind, Mail, ModifierEntry, Modifiers
from hilserver.kernel.modifier_mail import show_mail


@dataclass(frozen=True, slots=True)
class ModifierCommand:
    """One command: `operation` on the entries `number`, or a new entry."""

    operation: int
    number: int = 0
    entry: ModifierEntry | None = None


class Mailbox:
    """Sends the commands and reads the table; belongs to the event loop's thread."""

    def __init__(self, image: ProcessImage) -> None:
        self._image = image
        _, self._mail = image.region("modifier_mail")
        self._table = Modifiers.of(image.region("modifiers")[1])

    @property
    def head(self) -> int:
        """Commands sent so far."""
        return self._image.control.mail_head

    @property
    def tail(self) -> int:
        """Commands that the step has taken."""
        return self._image.control.mail_tail

    @property
    def room(self) -> int:
        """Commands that the step has room for now."""
        return lay.MAIL_ROWS - (self.head - self.tail)

    @property
    def timed_rows(self) -> int:
        """Timed input rows pushed so far."""
        return self._image.control.timed_head

    def send(self, commands: Sequence[ModifierCommand]) -> None:
        """Hand over commands; one tick takes all of them.

        ValueError if the step has no room for them now.
        """
        if len(commands) > self.room:
            raise ValueError(
                f"{len(commands)} commands are too many at once; try again"
            )
        head = self.head
        for offset, command in enumerate(commands):
            place = ((head + offset) & (lay.MAIL_ROWS - 1)) * lay.MAIL_ROW
            mail = Mail.of(self._mail, place)
            if command.entry is not None:
                mail.entry = command.entry
            mail.operation = command.operation
            mail.entry.number = command.number
        show_mail(head + len(commands), self._image.words)

    def acting(self) -> list[ModifierEntry]:
        """Return a copy of the modifiers in the arena; between two ticks it is exact."""
        table = self._table.copy()
        return [
            entry for entry in table.entries[: table.count] if entry.kind in set(Kind)
        ]

    @property
    def timeouts(self) -> int:
        """How often the command time-out has fired."""
        return int(self._table.timeouts)

    @property
    def is_silent(self) -> bool:
        """Whether the command time-out holds the set-points at zero."""
        return bool(self._table.silent)
