"""Logs: tables of signals over time, written and read as CSV and as MCAP.

A recording by hilserver also carries its origin and the states from which it can be replayed, see
`Log.run` and `Log.states`.
"""

from hilserver.logs.log import Log, RecordedState
from hilserver.logs.reading import read_log
from hilserver.logs.writer import LogWriter, Segmented
from hilserver.logs.writing import open_writer

__all__ = ["Log", "LogWriter", "RecordedState", "Segmented", "open_writer", "read_log"]
