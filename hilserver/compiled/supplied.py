"""Compiled code that came with the installation, so that not every computer compiles it again.

A wheel for one interpreter and one architecture carries it in `objects/` beside this file, made by
``make wheel`` for any processor of the architecture. It is looked for after the user's own cache,
and never written to. It fits exactly the sources and the versions that it was made with; where they
differ, the code is compiled as without it.
"""

import json
import os
import platform
import sys
from pathlib import Path
from typing import Final

import llvmlite
import numba
import numpy as np

import hilserver.cache
from hilserver.cache import whole

OBJECTS: Final = Path(__file__).with_name("objects")
MADE_WITH: Final = "made_with.json"
ANY_PROCESSOR: Final = ("generic", "")
"""LLVM's name of a processor, and its extensions, for code that each one of a family runs."""

_PACKAGES: Final = ("numba", "llvmlite", "numpy")


def environment() -> dict[str, str]:
    """Return all that compiled code depends on, apart from its sources and the processor."""
    return {
        "interpreter": str(sys.implementation.cache_tag),
        "architecture": platform.machine(),
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "numpy": np.__version__,
    }


class Supplied:
    """What the installation brought along for the sources with the hash `kernel_hash`.

    What is damaged, or belongs to neither this user nor root, counts as absent.
    """

    def __init__(self, kernel_hash: str, objects: Path = OBJECTS) -> None:
        self._objects = objects
        self.folder = objects / kernel_hash
        self.is_there = self.folder.is_dir()
        self._is_told = False

    def get(self, name: str) -> bytes | None:
        """Return what was made under `name`."""
        return whole(self.folder / name)

    def tell_why_absent(self) -> None:
        """Say once why something is compiled although the installation brought compiled code."""
        if self._is_told:
            return
        self._is_told = True
        why = self._why_absent()
        if why:
            hilserver.cache.tell(why)

    def _why_absent(self) -> str:
        begin = "the compiled code that this installation brought along"
        try:
            made_with = json.loads(
                (self._objects / MADE_WITH).read_text(encoding="utf-8")
            )
            owner = (self._objects / MADE_WITH).stat().st_uid
        except (OSError, ValueError):  # it brought none
            return ""
        here = environment()
        other = [name for name in here if made_with.get(name) != here[name]]
        if other:
            was = ", ".join(f"{name} {made_with.get(name)}" for name in other)
            now = ", ".join(f"{name} {here[name]}" for name in other)
            wanted = " ".join(f"{name}=={made_with.get(name)}" for name in _PACKAGES)
            cure = (
                f"'pip install {wanted}' avoids that"
                if {*other} <= {*_PACKAGES}
                else ""
            )
            return (
                f"{begin} was made with {was}, and this is {now}: it is compiled anew"
                f"{cure and f'; {cure}'}"
            )
        if owner not in (0, os.geteuid()):
            return (
                f"{begin} belongs to another user (id {owner}) and is not executed: it is compiled"
                " anew; an installation by root or by this user avoids that"
            )
        if not self.is_there:
            return f"the sources of this installation have been changed since {begin} was made"
        return ""  # something that was not foreseen, such as an own block
