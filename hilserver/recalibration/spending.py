"""How much error a look may spend: so much a year, however often somebody looks.

A false proposal needs two errors: a cause is named that is none, and its patch gains on the next
window by chance. The first has the level of the diagnosis. The second gets what is left of the
budget that has come in since the last look, at a constant rate; so many looks in a row get little
each, and a rare one gets more.
"""

from dataclasses import dataclass
from typing import Final

NAMED_LEVEL: Final = 0.01
"""Of a diagnosis as a whole: any finding in a log without an effect (specification)."""
YEAR_S: Final = 365.25 * 86400.0
LONGEST_S: Final = 86400.0  # a pause of months saves nothing up
WEAKEST: Final = 0.01  # however much has come in, no confirmation is weaker


@dataclass(frozen=True)
class Spending:
    """The budget of false proposals."""

    false_per_year: float = 1.0

    def joint(self, since_s: float) -> float:
        """Return the probability that named and confirmed are both wrong, for one look.

        Parameters
        ----------
        since_s : float
            Time since the last look [s].
        """
        return self.false_per_year * min(max(since_s, 0.0), LONGEST_S) / YEAR_S

    def confirmation(self, since_s: float) -> float:
        """Return the level of the confirmation of one look."""
        return min(self.joint(since_s) / NAMED_LEVEL, WEAKEST)
