"""The error that a look may spend: a fixed rate of false proposals a year, however many looks.

A false proposal takes two errors: a cause is named wrongly, and its patch is better on the next
window by chance. The first has the level of the diagnosis. The level of the second follows from the
budget, which accrues at a constant rate: frequent looks get little each, rare ones more.
"""

from dataclasses import dataclass
from typing import Final

NAMED_LEVEL: Final = 0.01
"""Probability that a diagnosis names anything in a log without an effect (specification)."""
YEAR_S: Final = 365.25 * 86400.0
LONGEST_S: Final = 86400.0  # a long pause saves up no more than this
WEAKEST: Final = 0.01  # no confirmation is weaker, whatever the budget


@dataclass(frozen=True)
class Spending:
    """The budget of false proposals."""

    false_per_year: float = 1.0

    def joint(self, since_s: float) -> float:
        """Return the probability that one look names wrongly and is confirmed by chance.

        Parameters
        ----------
        since_s : float
            Time since the last look [s].
        """
        return self.false_per_year * min(max(since_s, 0.0), LONGEST_S) / YEAR_S

    def confirmation(self, since_s: float) -> float:
        """Return the level of the confirmation of one look."""
        return min(self.joint(since_s) / NAMED_LEVEL, WEAKEST)
