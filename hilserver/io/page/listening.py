"""The socket that the page listens on."""

import errno
import os
import socket

from hilserver.errors import FailedError

_TRIES = 20
_BACKLOG = 128


def listen(host: str, port: int) -> socket.socket:
    """Listen on `port`, or the next free one.

    Raises
    ------
    FailedError
        If there is none, or the address cannot be used.
    """
    ports = [port + i for i in range(_TRIES) if port + i <= 65535] if port else [0]
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise _failure(host, port, error) from None
    for candidate in ports:
        listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((address[0], candidate, *address[2:]))
            listener.listen(_BACKLOG)
        except OSError as error:
            listener.close()
            if error.errno != errno.EADDRINUSE or candidate == ports[-1]:
                raise _failure(host, candidate, error) from None
        else:
            return listener
    raise FailedError(f"page: no port for {host}")


def url_of(listener: socket.socket, host: str, *, is_encrypted: bool) -> str:
    """Return the address that a browser opens."""
    port = listener.getsockname()[1]
    shown = f"[{host}]" if ":" in host else host
    return f"{'https' if is_encrypted else 'http'}://{shown}:{port}/"


def _failure(host: str, port: int, error: OSError) -> FailedError:
    reason = os.strerror(error.errno).lower() if error.errno else str(error)
    return FailedError(
        f"page: cannot listen on {host} port {port} ({reason}); change page.host or page.port"
    )
