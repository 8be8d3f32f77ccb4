"""The drives of which the thesis itself says that its simulation gets them wrong.

Each is a sealed log, or two groups of logs to compare, from a truth that is another program than
the plant, with the channels that the thesis had, and what must and must not be said about it.
"""

from hilserver.scenarios.drives import SCENARIOS, scenario
from hilserver.scenarios.expectation import Drive, Expectation, Judgement, Scenario, judge

__all__ = [
    "SCENARIOS",
    "Drive",
    "Expectation",
    "Judgement",
    "Scenario",
    "judge",
    "scenario",
]
