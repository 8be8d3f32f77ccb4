"""Cache of compiled kernels, and the one decorator that all kernels use.

numba's file cache checks the modification time of the file that contains a function, not the
functions it calls. A changed callee would silently run in its old form. The cache directory is
therefore keyed by a hash of the sources of all kernel rooms (and the version of numba). Kernels of
other rooms call those and their own room's: they have a subdirectory, keyed by those sources.
"""

import hashlib
from collections.abc import Callable, Iterable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import config
from numba.extending import register_jitable
from numba.np import linalg

from hilserver.cache import cache_folder


def _without_linear_algebra() -> None:
    """Load numba's arrays without scipy's linear algebra: saves 15 MB and a tenth of the start.

    numba only checks that it exists. Code that calls it, perhaps a user's block, loads it then.
    """
    asks, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    import_module("numba.np.arraymath")
    linalg.ensure_blas = asks


_without_linear_algebra()
_PACKAGE = Path(__file__).resolve().parent.parent
_KERNEL_ROOMS = ("status", "compiled", "plant", "body", "observer", "scheduler", "image", "kernel")


def kernel_sources() -> list[Path]:
    """Return every source file of the package that may hold compiled code, sorted."""
    files: list[Path] = []
    for room in _KERNEL_ROOMS:
        files += sorted((_PACKAGE / room).glob("*.py"))
        files += sorted(_PACKAGE.glob(f"{room}.py"))
    return files


def hash_of(sources: Iterable[Path], *extra: str) -> str:
    """Return a 16-digit hex hash over the contents of `sources` and the strings `extra`."""
    digest = hashlib.sha256()
    for text in (numba.__version__, llvmlite.__version__, np.__version__, *extra):
        digest.update(text.encode() + b"\0")
    for source in sources:
        digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()[:16]


@cache
def kernel_hash() -> str:
    """Return the hash of all kernel sources; recordings and snapshots contain it."""
    return hash_of(kernel_sources())


@cache
def cache_dir() -> Path:
    """Return (and make) the folder of this kernel hash."""
    return cache_folder(f"kernels-{kernel_hash()}")


@cache
def room_dir(room: Path) -> Path:
    """Return the directory for the kernels of one folder."""
    if not room.is_relative_to(_PACKAGE) or room.relative_to(_PACKAGE).parts[0] in _KERNEL_ROOMS:
        return cache_dir()
    return cache_dir() / hash_of(sorted(room.glob("*.py")))


def kernel(*signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function without Python objects and interpreter lock, cached on disk.

    Without fast-math the same inputs give the same bits in every pacing back end. Division follows
    IEEE 754 (``error_model="numpy"``): a kernel never raises.
    """
    settings = {"nogil": True, "cache": True, "error_model": "numpy", "fastmath": False} | options

    def decorate(function: Callable[..., Any]) -> Any:
        config.CACHE_DIR = str(room_dir(Path(function.__code__.co_filename).parent))
        return numba.njit(*signature, **settings)(function)

    return decorate


part: Callable[[Callable[..., Any]], Any] = kernel(_nrt=False)
"""A unit of the paced step: compiled once by itself, whichever configurations call it.

It allocates nothing, so numba's reference counting is off: it would cost a third of a tick.
"""

inlined: Callable[[Callable[..., Any]], Any] = kernel(_nrt=False, inline="always")
"""A helper that stands in its callers before their types are inferred.

What costs at a cold start is the number of compiled units, so this is what a function is that one
caller has, or that is short.
"""

plain: Callable[[Callable[..., Any]], Any] = register_jitable(error_model="numpy")
"""Ordinary Python that kernels can call, too."""


def c_function(signature: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function that C code calls by its address; cached like a kernel."""

    def decorate(function: Callable[..., Any]) -> Any:
        config.CACHE_DIR = str(room_dir(Path(function.__code__.co_filename).parent))
        return numba.cfunc(signature, nopython=True, cache=True)(function)

    return decorate
