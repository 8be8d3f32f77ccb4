"""The signal table: every signal named once.

The OPC UA address space, the log columns, the process image and the reference documentation are
generated from it. Names end in their unit. Each signal knows its slots in the frame of the process
image; an array is an alias of its scalars' slots, so that of two writes in one tick the later one
wins, be it to the array or to a scalar.
"""

from hilserver.signals.robot import BlockOutput, Ranges, robot_table
from hilserver.signals.table import Direction, Signal, SignalTable, ValueType
from hilserver.signals.vocabulary import (
    AUTOMATIC,
    LIGHTS,
    MEASURED,
    RESERVED,
    SAMPLED,
    SOURCES,
    Source,
    State,
)

__all__ = [
    "AUTOMATIC",
    "LIGHTS",
    "MEASURED",
    "RESERVED",
    "SAMPLED",
    "SOURCES",
    "BlockOutput",
    "Direction",
    "Ranges",
    "Signal",
    "SignalTable",
    "Source",
    "State",
    "ValueType",
    "robot_table",
]
