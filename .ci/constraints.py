"""Print the installed versions of what `make run` installs: the file constraints.txt.

Continuous integration renews it from an environment in which all tests have passed.
"""

import re
from importlib.metadata import PackageNotFoundError, distribution


def closure(name: str, found: dict[str, str]) -> None:
    """Add a package's requirements, and theirs; extras and other systems are left out."""
    for requirement in distribution(name).requires or ():
        required, _, marker = requirement.partition(";")
        match = re.match(r"[A-Za-z0-9_.-]+", required)
        key = "" if match is None else re.sub(r"[-_.]+", "-", match[0]).lower()
        if match is None or "extra" in marker or key in found:
            continue
        try:
            found[key] = distribution(match[0]).version
        except PackageNotFoundError:
            continue
        closure(match[0], found)


if __name__ == "__main__":
    versions: dict[str, str] = {}
    closure("hilserver", versions)
    print("# Versions that passed the tests: make run keeps to them, make constraints renews them.")
    print("\n".join(f"{name}=={version}" for name, version in sorted(versions.items())))
