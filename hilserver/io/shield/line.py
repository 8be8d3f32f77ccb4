"""The serial line: a pseudo-terminal with a symbolic link, or a device that exists."""

import contextlib
import fcntl
import os
import stat
import termios
import tty
from dataclasses import dataclass
from pathlib import Path

from hilserver.errors import FailedError


@dataclass(frozen=True)
class SerialLine:
    """An open line."""

    file: int  # file descriptor, opened without blocking
    path: Path  # what a host opens
    link: Path | None = None  # symbolic link to `path` that was made here

    def close(self) -> None:
        """Close the line and remove the link, unless it now points elsewhere."""
        with contextlib.suppress(OSError):
            if self.link is not None and self.link.readlink() == self.path:
                self.link.unlink()
        os.close(self.file)


def open_pseudo_terminal(link: Path) -> SerialLine:
    """Make a pseudo-terminal that behaves as a serial line, and a link to it.

    FailedError if the link cannot be made, or its name is taken.
    """
    if os.path.lexists(link) and not link.is_symlink():
        raise FailedError(
            f"shield.link: {link} exists and is not a link; choose another path"
        )
    file, host = os.openpty()
    try:
        path = Path(os.ttyname(host))
        _set_up(host)
        os.set_blocking(file, False)
        link.parent.mkdir(parents=True, exist_ok=True)
        made = link.with_name(f"{link.name}.{os.getpid()}.part")
        made.symlink_to(path)
        made.replace(link)
    except OSError as error:
        os.close(file)
        reason = (error.strerror or "refused").lower()
        raise FailedError(f"shield.link: cannot make {link}: {reason}") from None
    finally:
        os.close(host)  # only a host keeps it open, so that its hang-up is seen
    return SerialLine(file, path, link)


def open_device(path: Path) -> SerialLine:
    """Open a serial line for this process alone.

    FailedError if it does not exist, is not a serial line, or another program uses it.
    """
    try:
        file = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise FailedError(
            f"shield.device: there is no {path}; name a serial line such as /dev/ttyS1, or null for"
            " a pseudo-terminal"
        ) from None
    except OSError as error:
        reason = (error.strerror or "refused").lower()
        raise FailedError(f"shield.device: cannot open {path}: {reason}") from None
    try:
        if not stat.S_ISCHR(os.fstat(file).st_mode) or not os.isatty(file):
            raise FailedError(f"shield.device: {path} is not a serial line")
        fcntl.ioctl(file, termios.TIOCEXCL)
        _set_up(file)
    except (OSError, termios.error) as error:
        os.close(file)
        raise FailedError(f"shield.device: cannot set up {path}: {error}") from None
    except FailedError:
        os.close(file)
        raise
    return SerialLine(file, path)


def _set_up(file: int) -> None:
    """Set 115200 baud, 8 bits, no parity, one stop bit, no flow control, no echo."""
    tty.setraw(file)
    settings = termios.tcgetattr(file)
    settings[0] &= ~(termios.IXON | termios.IXOFF | termios.IXANY)
    settings[2] &= ~(termios.CSTOPB | termios.PARENB | termios.CRTSCTS)
    settings[2] |= termios.CS8 | termios.CLOCAL | termios.CREAD
    settings[4] = settings[5] = termios.B115200
    termios.tcsetattr(file, termios.TCSANOW, settings)
