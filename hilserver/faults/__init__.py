"""Faults and forced signals: what is wrong, from when to when, and on which signal or link.

`model` says what a fault is, `plan` turns it into modifiers of the compiled step, `book` injects,
ends and lists them; `links` holds those of peer links, `scenario` the timed ones of a file.
"""

from hilserver.faults.book import Faults
from hilserver.faults.links import PeerLine
from hilserver.faults.model import Fault
from hilserver.faults.scenario import Play, Scenario, load_scenario

__all__ = ["Fault", "Faults", "PeerLine", "Play", "Scenario", "load_scenario"]
