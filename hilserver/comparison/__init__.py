"""Two recordings of what should be the same run: where they part, and what may be the cause."""

from hilserver.comparison.comparing import RecordingComparison, compare
from hilserver.comparison.curves import Curves
from hilserver.comparison.text import as_text

__all__ = ["Curves", "RecordingComparison", "as_text", "compare"]
