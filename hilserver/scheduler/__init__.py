"""Fixed step, several time slices: law, pacing back ends, statistics. No plant and no I/O."""

from hilserver.scheduler.overruns import OverrunReport
from hilserver.scheduler.pacing import StopReason
from hilserver.scheduler.policies import OverrunLimits, OverrunPolicy
from hilserver.scheduler.realtime import RealtimeSettings
from hilserver.scheduler.scheduler import Scheduler
from hilserver.scheduler.slices import Slice
from hilserver.scheduler.statistics import Statistics, map_statistics, words_needed
from hilserver.scheduler.step import StepFunction

__all__ = [
    "OverrunLimits",
    "OverrunPolicy",
    "OverrunReport",
    "RealtimeSettings",
    "Scheduler",
    "Slice",
    "Statistics",
    "StepFunction",
    "StopReason",
    "map_statistics",
    "words_needed",
]
