"""Which keys are held now: a pure state machine on times in seconds.

Where releases are reported, a key is held until its own. Elsewhere a terminal tells of a held key
only by repeating it, after a delay that the user has set: a first press counts for `FIRST_S`, and
once repeats come, `REPEAT_S` without one is a release.
"""

from typing import Final

FIRST_S: Final = 0.7
REPEAT_S: Final = 0.15


class Hold:
    """Keys that are held."""

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
        """Hold nothing any more."""
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
        """How a hold ends, for the user."""
        if self.has_releases:
            return "the release of its key (kitty keyboard protocol)"
        return (
            f"{REPEAT_S * 1e3:g} ms without a key repeat, {FIRST_S * 1e3:g} ms after a first press"
        )
