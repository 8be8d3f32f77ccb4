"""A robot whose daemon writes to a terminal, which can be told to stand still."""

import contextlib
import os
import threading

from tests.control.robot import Robot

CTRL_S, CTRL_Q = b"\x13", b"\x11"


class TerminalRobot(Robot):
    """Drives alone: no peer, no shield."""

    def __init__(self, folder, domain, **sections):
        super().__init__(folder, domain, **sections)
        self.config["peers"] = []
        self.config["shield"]["enabled"] = False

    def _spawned(self, command, log):
        self._terminal, theirs = os.openpty()
        self._is_read = threading.Event()
        self._is_read.set()
        try:
            process = self._writing_to(theirs, command)
        finally:
            os.close(theirs)
        log.touch()
        threading.Thread(
            target=self._read, args=(self._terminal, log), daemon=True
        ).start()
        return process

    def _read(self, terminal, log):
        with (
            contextlib.suppress(OSError),
            log.open("ab") as file,
        ):  # at its end all have closed it
            while data := os.read(terminal, 1 << 16):
                file.write(data)
                file.flush()
                self._is_read.wait()
        os.close(terminal)

    def stall(self):
        """Press Ctrl-S; nobody reads either."""
        self._is_read.clear()
        os.write(self._terminal, CTRL_S)

    def go_on(self):
        """Press Ctrl-Q."""
        os.write(self._terminal, CTRL_Q)
        self._is_read.set()
