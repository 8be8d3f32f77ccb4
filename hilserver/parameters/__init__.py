"""What can be set: one table, and how its values become a robot again."""

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
