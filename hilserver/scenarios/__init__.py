"""The drives that, by the thesis itself, its simulation gets wrong.

Each is a sealed log, or two groups of logs to compare, with the channels of the thesis, and with
what must and must not be found. The truth comes from a program other than the plant.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

if (
    find_spec("hilserver_injector") is None
):  # not a checkout: it is in this folder, see setup.py
    sys.path.append(str(Path(__file__).parent / "installed"))

from hilserver.scenarios.drives import SCENARIOS, scenario

__all__ = ["SCENARIOS", "scenario"]
