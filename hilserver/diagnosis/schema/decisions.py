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
    size: float | None  # estimate when it is taken alone; None: it is not physically possible
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
        Error before by error after the step on blocks that took no part in the fits, geometric mean
        over the quantities; below 1 the step costs some. None: it was not tried there.
    group : str or None
        Of ``--group``.
    """

    cause: str
    action: Action
    held_out_gain: float | None
    reason: str
    group: str | None = None
