"""A limited number of places, so given that who asks for something gets in, however many are held.

=========  =====================================================================================
opens      has not asked for anything yet: yields at once when all places are taken
watches    has asked, and yields after `YIELDS_AFTER_S` without progress
drives     has commanded: yields as the last
=========  =====================================================================================

Among those that may yield, the address with the most places loses the one without progress for the
longest time. One address gets half of the places, this computer's own all of them.

`hilserver.opcua.places` and `hilserver.opcua.transport` are built on the same principle; they know
sessions and users besides.
"""

import time
from collections import Counter
from collections.abc import Callable
from enum import IntEnum
from typing import Final

from hilserver.opcua.loopback import is_loopback

YIELDS_AFTER_S: Final = 5.0


class PlaceUse(IntEnum):
    """What a place is used for, in the order in which they yield."""

    OPENS = 0
    WATCHES = 1
    DRIVES = 2


class KeptPlace:
    """The place of one client; `end` makes it leave."""

    def __init__(self, address: str, end: Callable[[], None], now_s: float) -> None:
        self.address = address
        self.end = end
        self.use = PlaceUse.OPENS
        self.since_s = now_s


class PlaceKeeper:
    """Decides who comes in, and who yields to whom."""

    def __init__(
        self, most: int, monotonic_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._most = most
        self._now_s = monotonic_s
        self._held: dict[KeptPlace, None] = {}

    def __len__(self) -> int:
        return len(self._held)

    def take(self, address: str, end: Callable[[], None]) -> KeptPlace | None:
        """Return a place for a newcomer, if necessary that of another; None if none yields."""
        share = self._most if is_loopback(address) else max(1, self._most // 2)
        own = [place for place in self._held if place.address == address]
        if len(own) >= share or len(self._held) >= self._most:
            among = own if len(own) >= share else self._held
            crowd = Counter(place.address for place in self._held)
            late_s = self._now_s() - YIELDS_AFTER_S
            may_yield = (
                p for p in among if p.use is PlaceUse.OPENS or p.since_s <= late_s
            )
            first = min(
                may_yield,
                key=lambda p: (p.use, -crowd[p.address], p.since_s),
                default=None,
            )
            if first is None:
                return None
            self.leave(first)
            first.end()
        place = KeptPlace(address, end, self._now_s())
        self._held[place] = None
        return place

    def progress(self, place: KeptPlace, use: PlaceUse = PlaceUse.WATCHES) -> None:
        """Note that a client has asked for something, or that its request has come further."""
        place.use, place.since_s = max(place.use, use), self._now_s()

    def leave(self, place: KeptPlace) -> None:
        """Free a place, also one that has been freed."""
        self._held.pop(place, None)
