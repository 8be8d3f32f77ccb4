"""Print the installed versions of what make installs: the file constraints.txt.

`.ci/run` renews it where all tests have passed with them.
"""

import tomllib
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


class Closure:
    """The packages that requirements of the project lead to, each with its installed version."""

    def __init__(self, project: dict) -> None:
        self.versions: dict[str, str] = {}
        self._own = canonicalize_name(project["name"])
        self._extras: dict[str, list[str]] = project["optional-dependencies"]
        self._seen: set[tuple[str, str]] = set()

    def add(self, text: str, wanting: str = "") -> None:
        """Add a requirement that stands under the extra `wanting`, and what it requires itself."""
        requirement = Requirement(text)
        if requirement.marker and not requirement.marker.evaluate({"extra": wanting}):
            return  # for another system, interpreter or extra
        name = canonicalize_name(requirement.name)
        for extra in ("", *requirement.extras):
            if (name, extra) in self._seen:
                continue
            self._seen.add((name, extra))
            for inner in self._required(name, extra):
                self.add(inner, extra)

    def _required(self, name: str, extra: str) -> list[str]:
        if name == self._own:
            return self._extras.get(extra, [])
        package = distribution(name)
        self.versions[name] = package.version
        return package.requires or []


if __name__ == "__main__":
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    closure = Closure(project)
    for requirement in (
        project["dependencies"] + project["optional-dependencies"]["dev"]
    ):
        closure.add(requirement)
    print("# Versions that passed the tests: make keeps to them, .ci/run renews them.")
    print(
        "\n".join(
            f"{name}=={version}" for name, version in sorted(closure.versions.items())
        )
    )
