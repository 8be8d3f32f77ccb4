"""Replay: the inputs of a log through the plant, as fast as possible.

A log of ours contains every input of every tick and an initial state: the plant then reproduces
the same bits. A log of others contains set-points, each held until the next row.
"""

from hilserver.replay.engine import Comparison, Engine
from hilserver.replay.origin import assembly_of
from hilserver.replay.plan import Plan, plan_exact, plan_inputs

__all__ = ["Comparison", "Engine", "Plan", "assembly_of", "plan_exact", "plan_inputs"]
