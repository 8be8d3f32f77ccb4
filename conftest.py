"""Load the test kit from this tree when the installed package does not bring it along."""

from importlib.metadata import entry_points

_INSTALLED = any(point.name == "hilserver" for point in entry_points(group="pytest11"))
pytest_plugins = ["pytester"] if _INSTALLED else ["pytester", "hilserver.testing.plugin"]
