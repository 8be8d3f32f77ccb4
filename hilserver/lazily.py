"""Names of a package that take long to import, imported on first use.

numba takes 70 MB and most of a second. A process that only watches (page, recorder, a command)
imports the same packages as the daemon, but without numba.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any


def lazily(package: str, **modules: tuple[str, ...]) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package (PEP 562).

    Parameters
    ----------
    modules : tuple of str
        For each module of the package, the names that it defines.
    """
    home = {name: module for module, names in modules.items() for name in names}

    def find(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{home[name]}"), name)

    return find
