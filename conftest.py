"""Load test kit and injector from this tree, whatever the installed package brings along."""

import sys
from importlib.metadata import entry_points
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "tests" / "injector"))

_INSTALLED = any(point.name == "hilserver" for point in entry_points(group="pytest11"))
pytest_plugins = ["pytester"] if _INSTALLED else ["pytester", "hilserver.testing.plugin"]
