"""What happens to the grid of planned starts when a tick comes a whole period too late.

Tick numbers are never skipped: every tick is executed once, in order. What a policy moves is the
*grid*, the planned starts. A planned start that is given up is a *missed tick*; simulated time then
stays one period behind real time.

Each policy is one pure function ``(late_ns, period_ns, limit_ticks) -> shift_ns``: by how much the
grid moves, given that a tick begins ``late_ns >= period_ns`` after its planned start. In the
timelines below a ``|`` is a planned start, a digit the tick that is executed, ``=`` a tick that
takes too long, ``x`` a planned start given up (a missed tick).
"""

from dataclasses import dataclass

from hilserver.compiled import inlined

CATCH_UP, SKIP, STRETCH, FAIL = range(4)
POLICY_NAMES = ("catch_up", "skip", "stretch", "fail")


@inlined
def catch_up_shift_ns(late_ns: int, period_ns: int, limit_ticks: int) -> int:
    """Run late ticks back to back until the grid is reached; give up what exceeds the limit.

    ::

        grid      |    |    |    |    |    |    |
        executed  0============= 123  4    5    6        limit 3: nothing is missed
        executed  0============= 13   4    5             limit 1: one start given up
                                 x
    """
    return max(0, late_ns // period_ns - limit_ticks) * period_ns


@inlined
def skip_shift_ns(late_ns: int, period_ns: int, limit_ticks: int) -> int:  # noqa: ARG001
    """Give up every planned start that has passed; continue on the same grid.

    ::

        grid      |    |    |    |    |    |    |
        executed  0============= 1    2    3    4
                       x    x
    """
    return late_ns // period_ns * period_ns


@inlined
def stretch_shift_ns(late_ns: int, period_ns: int, limit_ticks: int) -> int:  # noqa: ARG001
    """Move the grid by the delay: nothing is missed, all later ticks are delayed.

    ::

        grid      |    |         .    |    |    |
        executed  0============= 1    2    3    4
    """
    return late_ns


@inlined
def fail_shift_ns(late_ns: int, period_ns: int, limit_ticks: int) -> int:  # noqa: ARG001
    """Leave the grid alone: the scheduler stops after the first overrun.

    ::

        grid      |    |    |    |
        executed  0============= stop
    """
    return 0


@inlined
def shift_ns(policy: int, late_ns: int, period_ns: int, limit_ticks: int) -> int:
    """Return by how much `policy` moves the grid [ns]; 0 if less than one period late."""
    if late_ns < period_ns:
        return 0
    if policy == CATCH_UP:
        return int(catch_up_shift_ns(late_ns, period_ns, limit_ticks))
    if policy == SKIP:
        return int(skip_shift_ns(late_ns, period_ns, limit_ticks))
    if policy == STRETCH:
        return int(stretch_shift_ns(late_ns, period_ns, limit_ticks))
    return int(fail_shift_ns(late_ns, period_ns, limit_ticks))


@dataclass(frozen=True)
class OverrunPolicy:
    """A policy by name."""

    name: str = "catch_up"  # ``catch_up``, ``skip``, ``stretch`` or ``fail``
    # how many late ticks ``catch_up`` runs back to back (the others ignore it)
    catch_up_limit_ticks: int = 100

    def __post_init__(self) -> None:
        if self.name not in POLICY_NAMES:
            raise ValueError(
                f"overrun policy {self.name!r} is unknown; use one of {', '.join(POLICY_NAMES)}"
            )
        if self.catch_up_limit_ticks < 0:
            raise ValueError("catch_up_limit_ticks must not be negative")

    @property
    def code(self) -> int:
        """The policy's number in the law."""
        return POLICY_NAMES.index(self.name)


@dataclass(frozen=True)
class OverrunLimits:
    """Overruns tolerated before the scheduler requests the safe state; 0 switches a limit off."""

    single_ns: int = 0  # a tick that ends later than this after its deadline
    # number of overruns without a tick in between that ended in time
    consecutive: int = 0

    def __post_init__(self) -> None:
        if self.single_ns < 0 or self.consecutive < 0:
            raise ValueError(
                "overrun limits must not be negative (0 switches a limit off)"
            )
