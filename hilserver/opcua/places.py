"""Who gets a session: shares per address and per user, and a reserve for privileged users.

===============  ==================================================================================
no log-in yet    yields once it is a second old and others wait, and after 10 s in any case
no connection    yields when all places are taken
idle             yields after 5 s without a request: of the holder with the most sessions the one
                 that was silent longest
watchers         get all places except the reserve, so that users with a right to it find one
one address      half of the places, except this computer's own
one user name    half of the places
has_own_place    does not count for these: the application limits them itself
===============  ==================================================================================

A refused client gets BadTooManySessions.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.opcua.loopback import is_loopback

ACTIVATION_WITHIN_S, ACTIVATION_YIELDS_S = 10.0, 1.0
YIELDS_AFTER_S = 5.0


class SessionPlaces:
    """Decides which session may come in, and which one yields to it."""

    def __init__(self, most: int, has_reserve: Callable[[Any], bool]) -> None:
        self._most = most
        self._has_reserve = has_reserve
        self._reserve = most // 10
        self._share = max(1, most // 2)

    def create(self, sessions: Iterable[Any], address: str) -> None:
        """Make room for a session from an address; its user is not known yet."""
        own = [session for session in sessions if not session.visitor.has_own_place]
        now_s = time.monotonic()
        if len(own) >= self._most:
            for session in own:
                if (
                    not session.is_activated
                    and now_s - session.last_active_s > ACTIVATION_WITHIN_S
                ):
                    session.close()
        if address and not is_loopback(address):
            self._limit([s for s in own if s.address == address], self._share)
        self._limit(own, self._most)

    def activate(self, sessions: Iterable[Any], newcomer: Any, user: Any) -> None:
        """Make room for `newcomer`, whose user is known now."""
        if newcomer.visitor.has_own_place:
            return
        others = (s for s in sessions if s.is_activated and s is not newcomer)
        own = [s for s in others if not s.visitor.has_own_place]
        if user.name is not None:
            of_user = [s for s in own if s.user.name == user.name]
            self._limit(of_user, self._share)
        if not self._has_reserve(user):
            watchers = [s for s in own if not self._has_reserve(s.user)]
            self._limit(watchers, self._most - self._reserve)

    def _limit(self, sessions: list[Any], most: int) -> None:
        """Make one session yield if these are too many; BadTooManySessions if none does."""
        living = [session for session in sessions if session.is_open]
        if len(living) < most:
            return
        now_s = time.monotonic()
        crowd = Counter(session.holder for session in living)

        def rank(session: Any) -> tuple[bool, bool, int, float]:
            has_client = session.processor is not None
            return (
                session.is_activated,
                has_client,
                -crowd[session.holder],
                session.last_active_s,
            )

        for session in sorted(living, key=rank):
            patience_s = YIELDS_AFTER_S if session.is_activated else ACTIVATION_YIELDS_S
            if now_s - session.last_active_s > patience_s or session.processor is None:
                session.close()
                return
        raise ServiceError(ua.StatusCodes.BadTooManySessions)
