"""How the causes were found: their rows in the screen, and the decisions of the selection."""

from dataclasses import dataclass
from typing import Literal

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as checked

Action = Literal["taken", "refused", "swapped", "dropped"]


@dataclass(frozen=True, slots=True)
class ScreenRow:
    """One cause in the screen."""

    cause: str
    part: str  # empty: the cause itself
    # robust test statistic, and the value that it must exceed at the family-wise level
    statistic: float
    critical: float
    p_adjusted: float
    size: float | None  # estimate if it is taken alone; None if physically impossible
    standard_error: float  # robust one of `size`
    unit: str
    dof: float  # effective degrees of freedom


@checked(frozen=True, config=ConfigDict(extra="forbid"))
class Decision:
    """One step of the selection, in its order.

    Attributes
    ----------
    action : str
        ``taken``, ``refused``, ``swapped`` or ``dropped``.
    held_out_gain : float or None
        Error before over error after the step, on blocks left out of the fits, as geometric mean
        over the quantities; below 1 the step makes some worse. None: it was not tried there.
    group : str or None
        Of ``--group``.
    """

    cause: str
    action: Action
    held_out_gain: float | None
    reason: str
    group: str | None = None
