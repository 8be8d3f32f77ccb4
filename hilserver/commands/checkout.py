"""Modules next to the package in a checkout of its source, which are not installed with it."""

import importlib
import os
import sys
from pathlib import Path
from types import ModuleType

import hilserver


def beside(name: str) -> ModuleType | None:
    """Return a module of a package next to this one; None if this one is installed."""
    root = Path(hilserver.__file__).parents[1]
    if not (root / name.partition(".")[0] / "__main__.py").is_file():
        return None
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
        known = os.environ.get("PYTHONPATH")  # for processes that the module starts
        os.environ["PYTHONPATH"] = f"{root}{os.pathsep}{known}" if known else str(root)
    return importlib.import_module(name)
