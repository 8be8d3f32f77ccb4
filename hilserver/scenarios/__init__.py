"""The drives of which the thesis itself says that its simulation gets them wrong.

Each is a sealed log, or two groups of logs to compare, from a truth that is another program than
the plant, with the channels that the thesis had, and what must and must not be said about it.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

if find_spec("hilserver_injector") is None:  # not a checkout: it lies here, see setup.py
    sys.path.append(str(Path(__file__).parent / "installed"))

from hilserver.scenarios.drives import SCENARIOS, scenario

__all__ = ["SCENARIOS", "scenario"]
