"""How far the compiling of a start is, and how long it still takes."""

import json
import math
import time
from dataclasses import dataclass
from typing import Final, Self

from hilserver.cache import Shelf

FUNCTIONS: Final = 80
"""About as many has a robot without extras."""
FIRST_ESTIMATE_AFTER: Final = 10
"""Fewer say nothing of the pace, and nothing of what the cache holds of this robot."""
_KEPT_AS: Final = "last.json"


@dataclass
class CompileProgress:
    """What has been compiled so far, compared with the last time on this computer."""

    # functions; None: some are compiled already, nobody knows how many
    expected: int | None
    # of the last start that compiled all; infinite if there was none
    s_per_function: float
    count: int = 0
    begin_s: float = 0.0
    last_s: float = 0.0  # of the newest news

    @classmethod
    def begun(cls) -> Self:
        """Begin, before anything is put into the cache."""
        from hilserver.compiled import cache  # noqa: PLC0415 - with the compiler

        folders = cache.shelf().folder, cache.supplied().folder
        present = sum(1 for folder in folders for _ in folder.glob("*.nbc"))
        expected = FUNCTIONS
        pace_s = math.inf
        kept = Shelf("compiling").get(_KEPT_AS)
        if kept is not None:
            last = json.loads(kept)
            expected = last["functions"]
            pace_s = last["s"] / last["functions"]
        now_s = time.monotonic()
        return cls(
            None if present > FIRST_ESTIMATE_AFTER else expected,
            pace_s,
            begin_s=now_s,
            last_s=now_s,
        )

    def add(self, functions: int) -> None:
        """Count functions that are being compiled."""
        self.count += functions
        self.last_s = time.monotonic()

    @property
    def estimate(self) -> str:
        """How much it is, said at the beginning."""
        if self.expected is None:
            return "the functions that are missing"
        if math.isinf(self.s_per_function):
            return "the first time, that takes a minute or two"
        return f"about {_duration(self.expected * self.s_per_function)}"

    @property
    def line(self) -> str:
        """How far it is now, for a terminal."""
        if self.expected is None:
            return f"compiling: {self.count} functions so far"
        left = max(0, self.expected - self.count)
        pace_s = self.s_per_function
        if self.count >= FIRST_ESTIMATE_AFTER:
            pace_s = (self.last_s - self.begin_s) / self.count
        text = f"compiling: {self.count} of about {max(self.count, self.expected)} functions"
        if not left:
            return f"{text}, almost done"
        if math.isinf(pace_s):
            return text
        return f"{text}, {_duration(left * pace_s)} left"

    def ended(self) -> str:
        """Return how much it was; remember it for the next time, if it was all of a robot."""
        took_s = self.last_s - self.begin_s
        if self.expected is not None and self.count > FIRST_ESTIMATE_AFTER:
            data = json.dumps({"functions": self.count, "s": took_s})
            Shelf("compiling").put(_KEPT_AS, data.encode())
        return f"{self.count} functions in {_duration(took_s)}"


def _duration(s: float) -> str:
    whole = math.ceil(s)
    if whole < 60:
        return f"{whole} s"
    return f"{whole // 60} min {whole % 60} s"
