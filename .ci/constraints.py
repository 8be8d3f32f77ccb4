"""Print the installed versions of what `make run` installs: the file constraints.txt.

`.ci/run` renews it where all tests have passed with them.
"""

import re
import tomllib
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


def closure(requirements: Iterable[str], found: dict[str, str]) -> None:
    """Add the packages, and what they require; extras and other systems are left out."""
    for requirement in requirements:
        required, _, marker = requirement.partition(";")
        match = re.match(r"[A-Za-z0-9_.-]+", required)
        key = "" if match is None else re.sub(r"[-_.]+", "-", match[0]).lower()
        if match is None or "extra" in marker or key in found:
            continue
        try:
            package = distribution(match[0])
        except PackageNotFoundError:
            if marker:  # of another system
                continue
            raise
        found[key] = package.version
        closure(package.requires or (), found)


if __name__ == "__main__":
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    versions: dict[str, str] = {}
    closure(project["dependencies"] + project["optional-dependencies"]["physics"], versions)
    print("# Versions that passed the tests: make run keeps to them, .ci/run renews them.")
    print("\n".join(f"{name}=={version}" for name, version in sorted(versions.items())))
