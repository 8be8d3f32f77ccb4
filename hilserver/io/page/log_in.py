"""Users log in; who fails too often waits, and sees how long."""

import time

from hilserver.io.page.browsers import Browser
from hilserver.io.page.hand import RefusedError, WrongPasswordError
from hilserver.opcua.attempts import WINDOW_S, FailedAttempts, keys_of


class LogIns:
    """Counts failed log-ins as the daemon does, whose answer does not say that somebody waits.

    Parameters
    ----------
    limit : int
        Failed log-ins per user name or address in a minute.
    """

    def __init__(self, limit: int) -> None:
        self._attempts = FailedAttempts(limit, WINDOW_S)

    async def log_in(self, browser: Browser, name: str, password: str) -> None:
        """Open the session of a user.

        Raises
        ------
        RefusedError
            If name or password is wrong, or too many were.
        """
        keys, now_s = keys_of(name, browser.address), time.monotonic()
        if any(self._attempts.is_blocked(key, now_s) for key in keys):
            raise RefusedError("too many failed log-ins of this name or address: wait a minute")
        for key in keys:  # before the answer, or guesses in parallel would all pass
            self._attempts.failed(key, now_s)
        async with browser.lock:
            browser.user = ""
            try:
                await browser.hand.connect(name, password, browser.address)
            except WrongPasswordError:
                raise
            except BaseException:
                for key in keys:
                    self._attempts.withdraw(key)
                raise
            browser.user = name
        for key in keys:
            self._attempts.succeeded(key)
