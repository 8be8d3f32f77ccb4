"""From a program's first line to its exit code."""

import contextlib
import os
import sys
from collections.abc import Callable

from hilserver.errors import EXIT_DONE, EXIT_FAILED, UserError
from hilserver.program.ending import end_was_asked, ended_by_signals


def run(main: Callable[[], int]) -> int:
    """Run `main`; return its exit code.

    Errors that a user can fix are printed as sentences, never as tracebacks. SIGINT and SIGTERM are
    a clean end.
    """
    with ended_by_signals():
        try:
            return _run(main)
        except (Exception, SystemExit):
            # Interrupted code (a compiler, above all) may raise an error of its own.
            if end_was_asked():
                return EXIT_DONE
            raise


def _run(main: Callable[[], int]) -> int:
    try:
        code = main()
        if sys.stdout is not None:
            sys.stdout.flush()
    except UserError as error:
        for line in str(error).splitlines():
            print(f"hilserver: {line}", file=sys.stderr)
        return error.exit_code
    except MemoryError:
        print(
            "hilserver: there is not enough memory for this; use smaller files",
            file=sys.stderr,
        )
        return EXIT_FAILED
    except BrokenPipeError:  # the reader of our output, such as a pager, has ended
        _drop_output()
        return EXIT_FAILED
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        reason = (error.strerror or str(error)).lower() or "no answer in time"
        print(f"hilserver: {place}{reason}", file=sys.stderr)
        _drop_output()
        return EXIT_FAILED
    return code


def _drop_output() -> None:
    """Keep the interpreter from flushing output at its exit that nobody reads."""
    if sys.stdout is not None:
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
