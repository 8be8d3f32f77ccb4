"""The browsers: one entry each, found by its cookie, proved by its token."""

import asyncio
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from hilserver.io.page.hand import Hand

COOKIE = "hilserver_page"
MAX_BROWSERS = 200
MAX_TICKETS = 8
TICKET_S = 10.0
FORGOTTEN_AFTER_S = 3600.0


@dataclass(eq=False)
class Browser:
    """One browser."""

    hand: Hand
    # value of its cookie, which no script can read
    key: str = field(default_factory=lambda: secrets.token_urlsafe(32), repr=False)
    # written into the page; every POST has to carry it
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32), repr=False)
    user: str = ""  # name it has logged in with; empty: anonymous
    address: str = ""  # empty: not known yet
    live: int = 0  # open sockets
    # whether its user may stop the robot, by the last answer of the daemon, kept while it is silent
    may_stop: bool = False
    seen_s: float = field(default_factory=time.monotonic)
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)
    _tickets: dict[str, float] = field(default_factory=dict, repr=False)

    def new_ticket(self) -> str:
        """Return a ticket that opens one socket, once and within `TICKET_S`."""
        while len(self._tickets) >= MAX_TICKETS:
            del self._tickets[next(iter(self._tickets))]
        ticket = secrets.token_urlsafe(24)
        self._tickets[ticket] = time.monotonic() + TICKET_S
        return ticket

    def take_ticket(self, ticket: object) -> bool:
        """Whether the ticket is valid; it is used up by this."""
        until_s = self._tickets.pop(ticket, 0.0) if isinstance(ticket, str) else 0.0
        return time.monotonic() < until_s

    def knows(self, token: str) -> bool:
        """Whether `token` is ours."""
        return secrets.compare_digest(token.encode(), self.token.encode())


class Browsers:
    """All browsers; those without a log-in, not seen for longest, are forgotten first."""

    def __init__(
        self, make_hand: Callable[[], Hand], *, anonymous_may_stop: bool = False
    ) -> None:
        self._make_hand, self._may_stop = make_hand, anonymous_may_stop
        self._by_key: dict[str, Browser] = {}

    def find(self, key: str | None) -> Browser | None:
        """Return the browser with this cookie."""
        browser = self._by_key.get(key or "")
        if browser is not None:
            browser.seen_s = time.monotonic()
        return browser

    async def new(self) -> Browser:
        """Return a new one; others without an open socket make room, those without a user first."""
        idle = sorted(
            (b for b in self._by_key.values() if not b.live),
            key=lambda b: (b.user != "", b.seen_s),
        )
        while idle and len(self._by_key) >= MAX_BROWSERS:
            await self.forget(idle.pop(0))
        browser = Browser(self._make_hand(), may_stop=self._may_stop)
        self._by_key[browser.key] = browser
        return browser

    def rekey(self, browser: Browser) -> None:
        """Give it a new cookie: the old one may have been planted by an attacker."""
        self._by_key.pop(browser.key, None)
        browser.key = secrets.token_urlsafe(32)
        self._by_key[browser.key] = browser

    async def forget(self, browser: Browser) -> None:
        """Log out and forget."""
        self._by_key.pop(browser.key, None)
        await browser.hand.close()

    async def sweep(self) -> None:
        """Forget browsers that were not seen for an hour, and close their sessions."""
        now_s = time.monotonic()
        for browser in tuple(self._by_key.values()):
            if not browser.live and now_s - browser.seen_s > FORGOTTEN_AFTER_S:
                await self.forget(browser)

    async def close(self) -> None:
        """Forget all."""
        for browser in tuple(self._by_key.values()):
            await self.forget(browser)
