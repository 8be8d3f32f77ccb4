"""Passwords as scrypt hashes (RFC 7914): ``$scrypt$ln=15,r=8,p=1$<salt>$<hash>``, base64."""

import base64
import hashlib
import hmac
import re
import secrets

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
    log_n, r, p, salt, expected = _parts(text)
    return hmac.compare_digest(_scrypt(password, salt, log_n, r, p, len(expected)), expected)


def _parts(text: str) -> tuple[int, int, int, bytes, bytes]:
    found = _FORM.fullmatch(text)
    if found is None:
        raise ValueError("no scrypt hash")
    log_n, r, p, salt, key = found.groups()
    decode = base64.b64decode
    return int(log_n), int(r), int(p), decode(salt, validate=True), decode(key, validate=True)


def _scrypt(
    password: bytes, salt: bytes, log_n: int, r: int, p: int, length: int = _HASH_BYTES
) -> bytes:
    return hashlib.scrypt(
        password, salt=salt, n=1 << log_n, r=r, p=p, maxmem=_MAX_MEMORY, dklen=length
    )
