"""Requirements on a drive, each with a margin: how far it is from failing.

`model` is the form in a file, `judge` applies it to a drive. Sweeps, the test kit and
``hilserver simulate --require`` read the same requirements.
"""

from hilserver.requirements.judge import CheckError, Drive, Judge, margin
from hilserver.requirements.model import Requirement, load_requirements

__all__ = ["CheckError", "Drive", "Judge", "Requirement", "load_requirements", "margin"]
