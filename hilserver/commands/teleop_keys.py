"""Keys of a terminal: bytes to presses and releases, and which keys are held now.

An ordinary terminal sends only presses. The kitty keyboard protocol adds repeats and releases
(https://sw.kovidgoyal.net/kitty/keyboard-protocol/); the terminal answers whether it has it.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

ASK: Final = "\x1b[>11u\x1b[?u\x1b[?1004h"
"""Asks for events of all keys, whether there will be any, and for changes of the focus."""
END: Final = "\x1b[?1004l\x1b[<u"

_SEQUENCE = re.compile(r"\x1b\[([?<>]?)([0-9;:]*)([A-Za-z~])|\x1bO([A-D])")
_INCOMPLETE = re.compile(r"\x1b(\[[?<>]?[0-9;:]*|O)?\Z")
_ARROWS: Final = {"A": "up", "B": "down", "C": "right", "D": "left"}
_CONTROL: Final = 4  # bit of the modifiers, which count from 1
_RELEASE: Final = 3
_LONGEST: Final = 64


class Word(Enum):
    """What comes from a terminal besides keys."""

    HAS_RELEASES = auto()
    LOST_FOCUS = auto()


@dataclass(frozen=True, slots=True)
class Key:
    """One press (or repeat), or one release."""

    name: str
    is_down: bool = True


class KeyReader:
    """Turns what a terminal sends into keys; a sequence may come in pieces."""

    def __init__(self) -> None:
        self._rest = ""

    def feed(self, text: str) -> Iterator[Key | Word]:
        """Yield what `text` completes."""
        text = self._rest + text
        self._rest = ""
        while text:
            if text[0] != "\x1b":
                yield Key("ctrl-c" if text[0] == "\x03" else text[0].lower())
                text = text[1:]
            elif found := _SEQUENCE.match(text):
                mark, numbers, last, arrow = found.groups()
                if arrow is not None:
                    yield Key(_ARROWS[arrow])
                elif mark == "?" and last == "u":
                    if int(numbers or 0) & 2:
                        yield Word.HAS_RELEASES
                elif mark == "" and last == "O" and not numbers:
                    yield Word.LOST_FOCUS
                elif mark == "" and (last in _ARROWS or last == "u"):
                    fields = [part.split(":") for part in numbers.split(";")]
                    modifiers, event = _modifiers(fields)
                    name = _ARROWS.get(last) or _letter(fields[0][0])
                    if name == "c" and modifiers & _CONTROL:
                        name = "ctrl-c"
                    if name:
                        yield Key(name, event != _RELEASE)
                text = text[found.end() :]
            elif _INCOMPLETE.match(text) and len(text) < _LONGEST:
                self._rest = text
                return
            else:
                text = text[1:]


def _modifiers(fields: list[list[str]]) -> tuple[int, int]:
    """Return modifiers and event (1 press, 2 repeat, 3 release) of a key."""
    given = fields[1] if len(fields) > 1 else []
    modifiers = int(given[0]) - 1 if given and given[0] else 0
    code = int(given[1]) if len(given) > 1 and given[1] else 1
    return modifiers, code


def _letter(code: str) -> str:
    number = int(code or 0)
    return chr(number).lower() if 32 <= number < 127 else ""


FIRST_S: Final = 0.7
REPEAT_S: Final = 0.15


class Hold:
    """Keys that are held: a pure state machine on times in seconds.

    Where releases are reported, a key is held until its release. Other terminals show a held key
    only by repeating it, after a delay that the user has set: a first press counts for `FIRST_S`,
    and once repeats come, `REPEAT_S` without one counts as a release.
    """

    def __init__(self) -> None:
        self.has_releases = False  # the terminal reports releases
        self._until_s: dict[str, float] = {}

    def press(self, key: str, now_s: float) -> None:
        """Note a press or a repeat."""
        repeats = now_s < self._until_s.get(key, now_s)
        self._until_s[key] = now_s + (REPEAT_S if repeats else FIRST_S)

    def release(self, key: str) -> None:
        """Note a release."""
        self._until_s.pop(key, None)

    def release_all(self) -> None:
        """Release all keys."""
        self._until_s.clear()

    def held(self, now_s: float) -> frozenset[str]:
        """Return the keys that are held at `now_s`."""
        if not self.has_releases:
            self._until_s = {k: t for k, t in self._until_s.items() if now_s < t}
        return frozenset(self._until_s)

    def next_end_s(self) -> float | None:
        """Return when the next key ends by itself, None if none does."""
        return None if self.has_releases else min(self._until_s.values(), default=None)

    @property
    def words(self) -> str:
        """How a hold ends, in words for the user."""
        if self.has_releases:
            return "when the key is released (kitty keyboard protocol)"
        return (
            f"after {REPEAT_S * 1e3:g} ms without a repeat, {FIRST_S * 1e3:g} ms after the first"
            f" press"
        )
