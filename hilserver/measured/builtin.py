"""The mappings that come with hilserver, by name."""

from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path


def builtin_mappings() -> tuple[str, ...]:
    """Return the names of the mappings that come with hilserver."""
    files = [Path(file.name) for file in builtin_folder().iterdir()]
    return tuple(sorted(file.stem for file in files if file.suffix == ".yaml"))


def builtin_folder() -> Traversable:
    """Return the folder of their files."""
    return resources.files("hilserver.measured") / "mappings"
