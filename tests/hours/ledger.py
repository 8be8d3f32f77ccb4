"""What users really did, and when it came to the daemon: what the judges know.

Every command has a speed of its own, so that what a wheel does tells whose command it follows, and
which one of them.
"""

import itertools
from dataclasses import dataclass, field

from tests.hours.network import Mark

FIRST_RPM, STEP_RPM, MOST_RPM = 10.0, 0.07, 85.0


@dataclass
class Speed:
    """One speed, and every time that somebody asked for it."""

    rpm: float
    user: str
    kind: str
    lease_ms: float
    said: list[Mark] = field(default_factory=list)
    # of a controller: when it was on offer
    said_ns: list[int] = field(default_factory=list)


@dataclass
class Act:
    """A call, such as Stop or Reset."""

    name: str
    user: str
    sent_ns: int
    mark: Mark | None = None
    done_ns: int | None = None  # when its answer came
    is_accepted: bool | None = None  # None: nobody knows, the answer was lost
    refusal: str = ""
    argument: object = None


class Ledger:
    """All commands and acts of one seed."""

    def __init__(self) -> None:
        self.speeds: dict[float, Speed] = {}
        self.neutral: dict[str, list[Mark]] = {}
        self.acts: list[Act] = []
        self.forced: list[tuple[float, Act]] = []
        self._numbers = itertools.count()

    def new_speed(self, user: str, kind: str, lease_ms: float) -> Speed:
        """Return a speed that nobody had before."""
        span = round((MOST_RPM - FIRST_RPM) / STEP_RPM)
        rpm = FIRST_RPM + STEP_RPM * (next(self._numbers) * 389 % span)
        self.speeds[round(rpm, 3)] = speed = Speed(rpm, user, kind, lease_ms)
        return speed
