"""Logs: tables of signals over time, written and read as CSV and as MCAP.

A recording by hilserver also carries its origin and the states from which it can be replayed, see
`Log.run` and `Log.states`.
"""

from typing import TYPE_CHECKING

from hilserver.lazily import lazily

if TYPE_CHECKING:
    from hilserver.logs.log import Log, RecordedState
    from hilserver.logs.reading import read_log
    from hilserver.logs.writer import LogWriter, Segmented
    from hilserver.logs.writing import open_writer
else:  # a daemon neither reads nor writes logs: its recorder is another process
    __getattr__ = lazily(
        __name__,
        log=("Log", "RecordedState"),
        reading=("read_log",),
        writer=("LogWriter", "Segmented"),
        writing=("open_writer",),
    )

__all__ = ["Log", "LogWriter", "RecordedState", "Segmented", "open_writer", "read_log"]
