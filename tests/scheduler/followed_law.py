"""The law of the pacing loop, followed by hand."""

from dataclasses import dataclass

from hilserver.scheduler.law import (
    BACKLOG,
    CURRENT,
    KIND,
    KIND_NAMES,
    LATENCY,
    MISSED,
    PLANNED,
    TICK,
    WAIT,
    advance,
    begin,
    conclude,
    hold,
    law_array,
)
from hilserver.scheduler.policies import OverrunLimits, OverrunPolicy


@dataclass(frozen=True, slots=True)
class Decision:
    """What the law says at one instant.

    Attributes
    ----------
    run : bool
        False: wait until `planned_ns`; the other fields then describe the tick to come.
    due : tuple of int
        Indices of the slices that run in this tick.
    missed : int
        Planned starts given up.
    shift_ns : int
        By how much the policy moved the grid.
    """

    run: bool
    tick: int
    planned_ns: int
    due: tuple[int, ...]
    missed: int
    shift_ns: int
    latency_ns: int
    backlog: bool


class Law:
    """The law for Python."""

    def __init__(
        self,
        *,
        base_period_ns: int,
        period_ticks: tuple[int, ...] = (1,),
        policy: OverrunPolicy | None = None,
        limits: OverrunLimits | None = None,
        first_planned_ns: int = 0,
        warm_up_ticks: int = 0,
    ) -> None:
        self.state = law_array(
            base_period_ns,
            policy or OverrunPolicy(),
            limits or OverrunLimits(),
            warm_up_ticks,
        )
        self._period_ticks = period_ticks
        begin(self.state, first_planned_ns)

    def advance(self, now_ns: int) -> Decision:
        """Say what is to be done at `now_ns` [ns]; after ``run`` call `conclude`."""
        state = self.state
        planned = int(state[PLANNED])
        tick = int(state[TICK])
        due = tuple(
            i for i, ticks in enumerate(self._period_ticks) if tick % ticks == 0
        )
        if advance(state, now_ns) == WAIT:
            return Decision(False, tick, planned, due, 0, 0, 0, backlog=False)
        current = int(state[CURRENT])
        return Decision(
            run=True,
            tick=tick,
            planned_ns=current,
            due=due,
            missed=int(state[MISSED]),
            shift_ns=current - planned,
            latency_ns=int(state[LATENCY]),
            backlog=bool(state[BACKLOG]),
        )

    def conclude(self, end_ns: int) -> tuple[str, int]:
        """Close the tick; return the kind of overrun (or ``none``) and the verdict."""
        verdict = int(conclude(self.state, end_ns))
        return KIND_NAMES[self.state[KIND]], verdict

    def hold(self, now_ns: int) -> None:
        """Let one planned start pass while paused."""
        hold(self.state, now_ns)
