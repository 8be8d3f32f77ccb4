"""What a service tells systemd: one datagram per message, as sd_notify(3) describes it."""

import os
import socket


def notify(*assignments: str) -> bool:
    """Send assignments such as ``READY=1`` to the service manager.

    Returns
    -------
    bool
        False when there is none (``NOTIFY_SOCKET`` is not set) or when it does not listen.
    """
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return False
    if address.startswith("@"):  # an abstract socket
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            sender.setblocking(False)  # a full queue must not stop the event loop
            sender.sendto("\n".join(assignments).encode(), address)
    except OSError:
        return False
    return True


def watchdog_period_s() -> float | None:
    """Return how long [s] the service manager bears silence of this process; None: for ever."""
    pid = os.environ.get("WATCHDOG_PID", "")
    period_us = os.environ.get("WATCHDOG_USEC", "")
    if not period_us.isdigit() or pid not in ("", str(os.getpid())):
        return None
    return int(period_us) / 1e6 or None
