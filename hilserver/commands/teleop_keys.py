"""Keys of a terminal: bytes to presses and releases.

An ordinary terminal sends presses alone. The kitty keyboard protocol adds repeats and releases
(https://sw.kovidgoyal.net/kitty/keyboard-protocol/); whether a terminal has it, it answers itself.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

ASK: Final = "\x1b[>11u\x1b[?u\x1b[?1004h"
"""Asks for events of all keys, whether they will come, and for word of the window's focus."""
END: Final = "\x1b[?1004l\x1b[<u"

_SEQUENCE = re.compile(r"\x1b\[([?<>]?)([0-9;:]*)([A-Za-z~])|\x1bO([A-D])")
_INCOMPLETE = re.compile(r"\x1b(\[[?<>]?[0-9;:]*|O)?\Z")
_ARROWS: Final = {"A": "up", "B": "down", "C": "right", "D": "left"}
_CONTROL: Final = 4  # bit of the modifiers, which count from 1
_RELEASE: Final = 3
_LONGEST: Final = 64


class Word(Enum):
    """What comes from a terminal beside keys."""

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
        text, self._rest = self._rest + text, ""
        while text:
            if text[0] != "\x1b":
                yield Key("ctrl-c" if text[0] == "\x03" else text[0].lower())
                text = text[1:]
            elif found := _SEQUENCE.match(text):
                yield from _meaning(found)
                text = text[found.end() :]
            elif _INCOMPLETE.match(text) and len(text) < _LONGEST:
                self._rest = text
                return
            else:
                text = text[1:]


def _meaning(found: re.Match[str]) -> Iterator[Key | Word]:
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


def _modifiers(fields: list[list[str]]) -> tuple[int, int]:
    """Return modifiers and event (1 press, 2 repeat, 3 release) of a key."""
    given = fields[1] if len(fields) > 1 else []
    modifiers = int(given[0]) - 1 if given and given[0] else 0
    return modifiers, int(given[1]) if len(given) > 1 and given[1] else 1


def _letter(code: str) -> str:
    number = int(code or 0)
    return chr(number).lower() if 32 <= number < 127 else ""
