"""How a bench starts a daemon of its own."""

import socket

DAEMON = "import sys; from hilserver.commands import main; sys.exit(main(sys.argv[1:]))"
"""What a process of Python runs to be the command line."""


def free_port() -> int:
    """Return a TCP port that nobody uses now."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])
