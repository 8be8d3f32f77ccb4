"""Fixed step, several time slices: law, pacing back ends, statistics. Knows no plant and no I/O."""

from hilserver.scheduler.causes import Cause
from hilserver.scheduler.lockstep import PeerSilentError
from hilserver.scheduler.overruns import OverrunReport
from hilserver.scheduler.pacing import StopReason
from hilserver.scheduler.policies import POLICY_NAMES, OverrunLimits, OverrunPolicy
from hilserver.scheduler.realtime import Grant, RealtimeSettings
from hilserver.scheduler.scheduler import BACKENDS, Scheduler
from hilserver.scheduler.slices import Slice, period_in_ticks
from hilserver.scheduler.statistics import (
    SliceFigures,
    Statistics,
    TickFigures,
    map_statistics,
    words_needed,
)
from hilserver.scheduler.step import STEP_SIGNATURE, StepFunction

__all__ = [
    "BACKENDS",
    "POLICY_NAMES",
    "STEP_SIGNATURE",
    "Cause",
    "Grant",
    "OverrunLimits",
    "OverrunPolicy",
    "OverrunReport",
    "PeerSilentError",
    "RealtimeSettings",
    "Scheduler",
    "Slice",
    "SliceFigures",
    "Statistics",
    "StepFunction",
    "StopReason",
    "TickFigures",
    "map_statistics",
    "period_in_ticks",
    "words_needed",
]
