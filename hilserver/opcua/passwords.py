"""Passwords as scrypt hashes (RFC 7914): ``$scrypt$ln=15,r=8,p=1$<salt>$<hash>``, base64.

After a few failed log-ins an address or a name has to wait.
"""

import base64
import hashlib
import hmac
import re
import secrets
from collections import OrderedDict, deque
from collections.abc import Hashable

from hilserver.opcua.loopback import is_loopback

_LOG_N, _R, _P = 15, 8, 1
_SALT_BYTES, _HASH_BYTES = 16, 32
_MAX_MEMORY = 128 * 1024 * 1024
MAX_PASSWORD_BYTES = 512
_FORM = re.compile(
    r"\$scrypt\$ln=(1[0-7]),r=(8),p=([1-4])\$([A-Za-z0-9+/=]{16,88})\$([A-Za-z0-9+/=]{40,88})"
)


def hash_password(password: str, log_n: int = _LOG_N) -> str:
    """Return the hash to put into the configuration; about 32 MB and 0.1 s of work."""
    salt = secrets.token_bytes(_SALT_BYTES)
    key = _scrypt(password.encode(), salt, log_n, _R, _P)
    texts = (base64.b64encode(part).decode() for part in (salt, key))
    return f"$scrypt$ln={log_n},r={_R},p={_P}$" + "$".join(texts)


def is_password(password: bytes, text: str) -> bool:
    """Whether `password` belongs to the hash; takes the same time for a wrong one."""
    parts = _FORM.fullmatch(text)
    if parts is None:
        raise ValueError("not a scrypt hash")
    log_n, r, p, salt_text, key_text = parts.groups()
    salt = base64.b64decode(salt_text, validate=True)
    expected = base64.b64decode(key_text, validate=True)
    found = _scrypt(password, salt, int(log_n), int(r), int(p), len(expected))
    return hmac.compare_digest(found, expected)


def _scrypt(
    password: bytes, salt: bytes, log_n: int, r: int, p: int, length: int = _HASH_BYTES
) -> bytes:
    return hashlib.scrypt(
        password, salt=salt, n=1 << log_n, r=r, p=p, maxmem=_MAX_MEMORY, dklen=length
    )


_MOST_KEYS = 1000
WINDOW_S = 60.0


def keys_of(name: str, address: str) -> tuple[Hashable, ...]:
    """Return the keys that a log-in counts for: user name and client address.

    The address of this computer does not count, nor a missing one: several users share it.
    """
    keys = (("name", name[:64]), ("address", address))
    if not address or is_loopback(address):
        return keys[:1]
    return keys


class FailedAttempts:
    """Counts failures per key in a sliding window.

    The number of keys is limited: the one without failures for longest is forgotten first.
    """

    def __init__(self, limit: int, window_s: float) -> None:
        self._limit = limit
        self._window_s = window_s
        self._failures: OrderedDict[Hashable, deque[float]] = OrderedDict()

    def is_blocked(self, key: Hashable, now_s: float) -> bool:
        """Whether `key` has to wait."""
        failures = self._failures.get(key)
        if failures is None:
            return False
        while failures and now_s - failures[0] >= self._window_s:
            failures.popleft()
        if not failures:
            del self._failures[key]
        return len(failures) >= self._limit

    def failed(self, key: Hashable, now_s: float) -> None:
        """Count one failure."""
        failures = self._failures.setdefault(key, deque(maxlen=self._limit))
        failures.append(now_s)
        self._failures.move_to_end(key)
        while len(self._failures) > _MOST_KEYS:
            self._failures.popitem(last=False)

    def withdraw(self, key: Hashable) -> None:
        """Take back the newest failure of `key`: the password was not checked."""
        if failures := self._failures.get(key):
            failures.pop()

    def succeeded(self, key: Hashable) -> None:
        """Forget the failures of `key`."""
        self._failures.pop(key, None)
