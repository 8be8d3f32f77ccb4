"""The socket that the page listens on, and its encryption."""

import errno
import socket
import ssl
from pathlib import Path

from hilserver.errors import ConfigError, FailedError, address_refused

_TRIES = 20
_BACKLOG = 128


def listen(host: str, port: int) -> socket.socket:
    """Listen on `port`, or the next free one.

    FailedError if there is none, or the address cannot be used.
    """
    ports = [port + i for i in range(_TRIES) if port + i <= 65535] if port else [0]
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM
        )[0]
    except OSError as error:
        raise address_refused(
            f"page: cannot listen on {host} port {port}", error
        ) from None
    for candidate in ports:
        listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((address[0], candidate, *address[2:]))
            listener.listen(_BACKLOG)
        except OSError as error:
            listener.close()
            if error.errno != errno.EADDRINUSE or candidate == ports[-1]:
                where = f"{host} port {candidate}"
                raise address_refused(
                    f"page: cannot listen on {where}", error
                ) from None
        else:
            return listener
    raise FailedError(f"page: no port for {host}")


def moved(listener: socket.socket, port: int) -> str:
    """Return why the page does not listen on `port`, the one asked for; empty if it does."""
    taken = listener.getsockname()[1]
    if port in (0, taken):
        return ""
    return f"port {port} (page.port) is in use by another program, the page has {taken}"


def tls_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """Return the TLS context of the page.

    ConfigError if certificate or key are missing or cannot be used.
    """
    for path in (certificate, key):
        try:
            path.open("rb").close()
        except OSError as error:
            raise ConfigError(f"{path} cannot be read: {error.strerror}") from None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate, key, password=_no_password)
    except ssl.SSLError as error:
        if error.reason == "KEY_VALUES_MISMATCH":
            raise ConfigError(
                f"{certificate} does not belong to the key {key}"
            ) from None
        raise ConfigError(
            f"{certificate} and {key} cannot be used: a certificate and its key in PEM form are"
            " needed"
        ) from None
    except ValueError:
        raise ConfigError(
            f"{key} has a password; store it without, readable by you only"
        ) from None
    return context


def key_notice(key: Path) -> str | None:
    """Return a warning if others on this computer can read the key of the page."""
    if not key.stat().st_mode & 0o077:
        return None
    return f"{key}: can be read by others, who could then pose as this page; run chmod 600 {key}"


def _no_password() -> str:
    raise ValueError  # without this function Python would prompt for one


def url_of(listener: socket.socket, host: str, *, is_encrypted: bool) -> str:
    """Return the address that a browser opens."""
    port = listener.getsockname()[1]
    shown = f"[{host}]" if ":" in host else host
    return f"{'https' if is_encrypted else 'http'}://{shown}:{port}/"
