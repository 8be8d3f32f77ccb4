"""The parameters that can be set: their table, and how values become a robot."""

from hilserver.parameters.table import PLANT, Parameter, table_of
from hilserver.parameters.values import check, geometric_gain, named, read, with_values

__all__ = [
    "PLANT",
    "Parameter",
    "check",
    "geometric_gain",
    "named",
    "read",
    "table_of",
    "with_values",
]
