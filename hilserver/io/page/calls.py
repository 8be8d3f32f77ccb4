"""What a browser may call by name: the page's own methods, and the daemon's."""

import logging
import math
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from hilserver.io.opcua_server.method_table import METHOD_OF, STRING
from hilserver.io.opcua_server.model import PARAMETERS
from hilserver.io.page.browsers import Browser, Browsers
from hilserver.io.page.driving import PageDriving
from hilserver.io.page.hand import RefusedError, WrongPasswordError
from hilserver.io.page.jobs import Jobs
from hilserver.io.page.live import Live
from hilserver.io.page.setup import Setup
from hilserver.io.page.stopping import SHOWN_S, Stopping
from hilserver.opcua.passwords import WINDOW_S, FailedAttempts, keys_of
from hilserver.signals.numbers import is_finite_number

ANY = ""
_RANGES = {
    "Byte": (0, 2**8 - 1),
    "UInt32": (0, 2**32 - 1),
    "Int64": (-(2**63), 2**63 - 1),
}
_WORDS = {
    STRING: "text",
    "Double": "a finite number",
    "Boolean": "true or false",
    "Byte": "an integer from 0 to 255",
    "UInt32": "a non-negative integer",
    "Int64": "an integer",
}


class WrongTypeError(Exception):
    """The arguments of a call do not fit; the sentence says what would."""


def fit(value: Any, kind: str) -> bool:
    """Whether a value from JSON can become this type; numbers are accepted as names."""
    if kind == ANY:
        return True
    if kind == STRING:
        return is_finite_number(value) or (
            isinstance(value, str) and _is_unicode(value)
        )
    if kind == "Boolean":
        return isinstance(value, bool) or value in (0, 1)
    if not is_finite_number(value):
        return False
    low, high = _RANGES.get(kind, (value, value))
    return low <= value <= high and (kind not in _RANGES or float(value).is_integer())


def check(
    name: str, given: Sequence[Any], wanted: Sequence[str], optional: int = 0
) -> None:
    """Check the arguments of a call; WrongTypeError says what is wrong."""
    if not len(wanted) - optional <= len(given) <= len(wanted):
        raise WrongTypeError(f"{name} takes {len(wanted)} arguments, not {len(given)}")
    for number, (value, kind) in enumerate(zip(given, wanted, strict=False), 1):
        if not fit(value, kind):
            raise WrongTypeError(f"{name}: argument {number} should be {_WORDS[kind]}")


def check_value(name: str, value: Any, kind: str) -> None:
    """Check the value for a signal; WrongTypeError says what it should be."""
    if not fit(value, kind):
        raise WrongTypeError(f"{name} should be {_WORDS[kind]}")


def _is_unicode(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


_log = logging.getLogger(__name__)


def may_work(browser: Browser) -> None:
    """Raise RefusedError if the role of a browser's user allows no work with files."""
    if "Start" not in browser.hand.rights.methods:
        raise RefusedError("your role does not allow this")


class LogIns:
    """Counts failed log-ins as the daemon does, whose answer hides that one has to wait."""

    def __init__(self, limit: int) -> None:
        self._attempts = FailedAttempts(limit, WINDOW_S)

    async def log_in(self, browser: Browser, name: str, password: str) -> None:
        """Open the session of a user.

        RefusedError if name or password is wrong, or too many attempts have failed.
        """
        keys, now_s = keys_of(name, browser.address), time.monotonic()
        if any(self._attempts.is_blocked(key, now_s) for key in keys):
            raise RefusedError(
                "too many failed log-ins for this name or address: wait a minute"
            )
        for key in keys:  # before the answer, or parallel guesses would all pass
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


class Calls:
    """Carries out calls of browsers, each with the rights of its user."""

    def __init__(
        self,
        setup: Setup,
        browsers: Browsers,
        live: Live,
        driving: PageDriving,
        jobs: Jobs,
        stopping: Stopping,
    ) -> None:
        self._setup, self._browsers, self._live = setup, browsers, live
        self._driving, self._jobs, self._stopping = driving, jobs, stopping
        self._log_ins = LogIns(setup.opcua.max_failed_logins)

    async def do(self, browser: Browser, name: str, arguments: Sequence[Any]) -> Any:
        """Carry out a call; WrongTypeError or RefusedError has the sentence for the user."""
        own: dict[str, tuple[Callable[..., Awaitable[Any]], tuple[str, ...]]] = {
            "login": (self._login, (STRING, STRING)),
            "logout": (self._logout, ()),
            "session": (self._session, ()),
            "ticket": (self._ticket, ()),
            "take": (self._take, ("Int64", "Int64")),
            "give": (self._give, (STRING,)),
            "write": (self._write, (STRING, ANY)),
            "set": (self._set, (ANY,)),
            "diagnose": (self._diagnose, (STRING, STRING)),
            "compare": (self._compare, (STRING, STRING)),
            "map": (self._map, (STRING, STRING)),
            "cancel": (self._cancel, ("Int64",)),
            "keep": (self._keep, ("Int64",)),
        }
        if name in own:
            check(name, arguments, own[name][1], optional=name in ("take", "diagnose"))
        elif name in METHOD_OF:
            check(name, arguments, [a.type for a in METHOD_OF[name].arguments])
        else:
            raise RefusedError(f"there is no method '{name:.40}'")
        is_stop = name == "Stop"
        if name not in ("login", "logout", "session") and not (
            is_stop and browser.may_stop
        ):
            await self.ready(browser)
        if is_stop:
            return await self._stopping.press(browser)(SHOWN_S)
        if name in own:
            return await own[name][0](browser, *arguments)
        await browser.hand.call(name, arguments)
        _log.info("page: %s calls %s", browser.user or "anonymous", name)
        return None

    async def ready(self, browser: Browser) -> None:
        """Connect a browser that needs no log-in; RefusedError for one that does."""
        async with browser.lock:
            if browser.hand.is_connected:
                return
            if self._setup.opcua.needs_login:
                browser.user = ""
                raise RefusedError("log in first")
            await browser.hand.connect()
            browser.may_stop = "Stop" in browser.hand.rights.methods

    async def report_stop(self, browser: Browser) -> None:
        """Report to the daemon that Stop was pressed, for its event and its audit."""
        await self.ready(browser)
        await browser.hand.call("Stop", ())

    async def _login(
        self, browser: Browser, name: str, password: str
    ) -> dict[str, Any]:
        if not self._setup.opcua.needs_login:
            raise RefusedError("this page needs no log-in")
        browser.may_stop = False
        await self._log_ins.log_in(browser, str(name)[:64], str(password)[:1024])
        self._browsers.rekey(browser)
        browser.may_stop = "Stop" in browser.hand.rights.methods
        return await self._session(browser)

    async def _logout(self, browser: Browser) -> None:
        browser.user, browser.may_stop = "", self._setup.opcua.anonymous_may_stop
        await browser.hand.close()

    async def _session(self, browser: Browser) -> dict[str, Any]:
        problem = ""
        try:
            await self.ready(browser)
        except RefusedError as error:
            problem = str(error)
        page = self._setup.page
        return {
            "user": browser.user,
            "needs_login": self._setup.opcua.needs_login
            and not browser.hand.is_connected,
            "problem": problem,
            "drive": browser.hand.rights.drive,
            "methods": browser.hand.rights.methods,
            "rate_hz": page.rate_hz,
            "deadman_ms": page.deadman_ms,
        }

    async def _ticket(self, browser: Browser) -> str:
        return browser.new_ticket()

    async def _take(
        self, browser: Browser, number: int, taken_from: int | None = None
    ) -> None:
        client = self._live.find(number)
        if client is None or client.browser is not browser:
            raise RefusedError("this page has no live connection")

        def check() -> None:
            if self._live.driver not in (None, number, taken_from):
                raise RefusedError(
                    "another browser is driving: confirm to take control"
                )

        await self._driving.take(client, check)
        if self._live.find(number) is not client:  # it has left meanwhile
            self._driving.leave(client)

    async def _give(self, browser: Browser, source: str) -> None:
        await browser.hand.write({"control.source": str(source)[:20]})

    async def _write(self, browser: Browser, name: str, value: float) -> None:
        known = next((s for s in self._setup.signals if s["name"] == name), None)
        if known is None or not known["writable"]:
            raise RefusedError(f"'{name!s:.60}' cannot be written")
        check_value(name, value, known["type"])
        await browser.hand.write({name: value})

    async def _set(self, browser: Browser, values: Any) -> None:
        """Change parameters, all in one tick; null as in config.yaml."""
        known = {row["name"] for row in self._setup.parameters}
        if not isinstance(values, dict) or not values:
            raise WrongTypeError("set takes parameter names with their values")
        for name, value in values.items():
            if name not in known:
                raise RefusedError(f"there is no parameter '{name:.60}'")
            if value is not None:
                check_value(name, value, "Double")
        numbers = {
            PARAMETERS + n: math.nan if v is None else v for n, v in values.items()
        }
        await browser.hand.write(numbers)

    async def _diagnose(self, browser: Browser, log: str, mapping: str = "") -> int:
        may_work(browser)
        return self._jobs.diagnose(log, str(mapping))

    async def _compare(self, browser: Browser, a: str, b: str) -> int:
        may_work(browser)
        return self._jobs.compare(a, b)

    async def _map(self, browser: Browser, log: str, text: str) -> None:
        may_work(browser)
        self._jobs.map(log, str(text))

    async def _cancel(self, browser: Browser, number: int) -> None:
        may_work(browser)
        self._jobs.cancel(number)

    async def _keep(self, browser: Browser, number: int) -> str:
        if "LoadPatch" not in browser.hand.rights.methods:
            raise RefusedError("your role does not allow this")
        return self._jobs.keep(number)
