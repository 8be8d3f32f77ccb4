"""Replay: the inputs of a log through the plant, as fast as possible.

A log of ours brings every input of every tick and a state to begin with: the plant then goes
through the same bits. A log of others brings set-points that hold until its next row.
"""

from hilserver.replay.engine import Comparison, Engine
from hilserver.replay.origin import assembly_of
from hilserver.replay.plan import Plan, plan_exact, plan_inputs

__all__ = ["Comparison", "Engine", "Plan", "assembly_of", "plan_exact", "plan_inputs"]
