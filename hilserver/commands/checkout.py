"""What stands beside the package in a checkout of its source, and is not installed with it."""

import importlib
import os
import sys
from pathlib import Path
from types import ModuleType

import hilserver


def beside(name: str) -> ModuleType | None:
    """Return a module of a package that stands beside this one; None where it is installed."""
    root = Path(hilserver.__file__).parents[1]
    if not (root / name.partition(".")[0] / "__main__.py").is_file():
        return None
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
        known = os.environ.get("PYTHONPATH")  # for the processes that it starts
        os.environ["PYTHONPATH"] = f"{root}{os.pathsep}{known}" if known else str(root)
    return importlib.import_module(name)
