"""Errors that a user can fix: each is one sentence, and has the exit code of its kind."""

import difflib
import errno
import os
from collections.abc import Iterable

EXIT_DONE = 0
EXIT_FAILED = 1
EXIT_BAD_LOG = EXIT_USAGE = 2
EXIT_SAFETY_LIMIT = 3
EXIT_DIFFERENT = 4
EXIT_BAD_CONFIGURATION = 78


class UserError(Exception):
    """Something the user can fix; printed as one sentence, never as a traceback."""

    exit_code = EXIT_FAILED


class FailedError(UserError):
    """The system refused: port in use, device absent, file not writable."""


class UsageError(UserError):
    """Words of a command line that can never work; the code is that of argparse."""

    exit_code = EXIT_USAGE


class ControlRefused(UserError):
    """A command that is not possible now; the sentence says why, or who has control."""


class LogError(UserError):
    """A log or mapping file that cannot be read."""

    exit_code = EXIT_BAD_LOG


class ConfigError(UserError):
    """A configuration or patch that cannot be used."""

    exit_code = EXIT_BAD_CONFIGURATION


NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
"""Errors that go away where there is more room for a file."""


def reason(error: OSError) -> str:
    """Return why a file cannot be written, in a few words."""
    if error.errno in NO_SPACE:
        return "no space left; free some"
    said = (error.strerror or str(error)).lower()
    return f"{said}; name a file" if error.errno == errno.EISDIR else said


ADDRESSES = {
    errno.EADDRINUSE: "end the program that uses it, or choose another port",
    errno.EADDRNOTAVAIL: "use an address of this computer",
    errno.EACCES: "a port below 1024 needs CAP_NET_BIND_SERVICE; choose another one",
}


def address_refused(what: str, error: OSError) -> FailedError:
    """Return why an address cannot be used, with the remedy; `what` names section and address."""
    number = error.errno or getattr(error.__context__, "errno", None) or 0
    # names: below 0
    why = os.strerror(number) if number > 0 else error.strerror or str(error)
    return FailedError(
        f"{what} ({why.lower()}); {ADDRESSES.get(number, 'check the address')}"
    )


_ALIKE, _SHORT = 0.7, 2
"""Least similarity to the intended name; names this short are part of too many others."""


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the name that was probably meant: a similar one, or the first that contains it."""
    names = list(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=_ALIKE)
    holds = [n for n in names if len(name) > _SHORT and name.lower() in n.lower()]
    return next(iter([*close, *holds]), None)


def meant(name: str, known: Iterable[str], otherwise: str) -> str:
    """Return the hint to follow a name that does not exist."""
    near = nearest(name, known)
    return otherwise if near is None else f"did you mean '{near}'?"


def no_signal(name: str, known: Iterable[str]) -> str:
    """Return the sentence for a signal name that does not exist."""
    hint = meant(name, known, "see 'hilserver signals'")
    return f"there is no signal '{name}'; {hint}"
