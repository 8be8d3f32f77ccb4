"""Run a command in a process group of its own, in the terminal's foreground; return its exit code.

make dies of Ctrl-C even when the program that it runs ends cleanly. A program in its own group gets
the Ctrl-C of the terminal alone, and make sees its exit code. Signals sent to this process are
passed on, once each.
"""

import ctypes
import os
import signal
import subprocess
import sys

PR_SET_PDEATHSIG = 1
PASSED_ON = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main(command: list[str]) -> int:
    """Run `command` and return its exit code, 128 + n when signal n killed it."""
    libc = ctypes.CDLL(None)
    is_foreground = os.isatty(0) and os.tcgetpgrp(0) == os.getpgrp()
    child = subprocess.Popen(  # noqa: S603 (the command is the Makefile's)
        command,
        process_group=0,
        preexec_fn=lambda: libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM),  # noqa: PLW1509 (no threads)
    )
    for number in PASSED_ON:
        signal.signal(number, lambda received, _: child.send_signal(received))
    # or handing over the terminal would stop us
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    if is_foreground:
        os.tcsetpgrp(0, child.pid)
    try:
        return _wait(child.pid)
    finally:
        if is_foreground:
            os.tcsetpgrp(0, os.getpgrp())


def _wait(pid: int) -> int:
    while True:
        _, status = os.waitpid(pid, os.WUNTRACED)
        if not os.WIFSTOPPED(status):
            code = os.waitstatus_to_exitcode(status)
            return code if code >= 0 else 128 - code
        # Ctrl-Z: nobody could bring a stopped plant back
        os.killpg(pid, signal.SIGCONT)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
