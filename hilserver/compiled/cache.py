"""Cache of compiled kernels, and the one decorator that all kernels use.

numba's file cache checks the file that contains a function, not the functions it calls. A changed
callee would silently run in its old form. The folder is therefore named by a hash of the sources of
all kernel rooms (and the version of numba). Kernels of other rooms call those and their own room's:
the names of their files have a hash of these sources, too.
"""

import contextlib
import hashlib
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import config
from numba.extending import register_jitable

import hilserver.cache
from hilserver.cache import KERNELS, Shelf, cache_folder, remove_old
from hilserver.compiled.supplied import Supplied


def _without_linear_algebra() -> None:
    """Load numba's arrays without scipy's linear algebra: saves 15 MB and a tenth of a second.

    numba only checks that it exists. Code that calls it, perhaps a user's block, loads it then.
    """
    linalg: Any = import_module("numba.np.linalg")
    asks, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    import_module("numba.np.arraymath")
    linalg.ensure_blas = asks


stored: Any = None  # our own cache, where this version of numba has what it is made of
try:
    from hilserver.compiled import stored
except (ImportError, AttributeError) as _moved:
    hilserver.cache.tell(
        f"numba {numba.__version__} has changed inside ({_moved}): it keeps compiled code itself,"
        " by the place of the sources; install a version that hilserver was tested with"
    )
if stored is None:
    _without_linear_algebra()
else:
    stored.on_miss.append(_without_linear_algebra)  # what is in the cache needs neither
_PACKAGE = Path(__file__).resolve().parent.parent
SETTINGS = {"nogil": True, "error_model": "numpy", "fastmath": False}
KERNELS_KEPT = 8
"""Folders of compiled code: this version's, and those of others that run on this computer."""

_KERNEL_ROOMS = (
    "status",
    "compiled",
    "plant",
    "body",
    "observer",
    "scheduler",
    "image",
    "kernel",
)


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
def shelf() -> Shelf:
    """Return what is kept of this kernel hash."""
    kept = Shelf(f"{KERNELS}{kernel_hash()}")
    remove_old(KERNELS, KERNELS_KEPT)
    return kept


@cache
def supplied() -> Supplied:
    """Return what the installation brought along for this kernel hash."""
    return Supplied(kernel_hash())


@cache
def source_stamp(source: Path) -> str:
    """Return what changes with every source that a function of the file `source` may call.

    The kernel hash, and with it the folder, changes with the sources of all kernel rooms. A file
    outside the package calls kernels, and what is in the file itself.
    """
    if not source.is_relative_to(_PACKAGE):
        with contextlib.suppress(OSError):
            return hash_of([source])
        return ""  # generated: the name of its module has the hash of its text
    if source.relative_to(_PACKAGE).parts[0] in _KERNEL_ROOMS:
        return ""
    return _room_stamp(source.parent)


@cache
def _room_stamp(room: Path) -> str:
    return hash_of(sorted(room.glob("*.py")))


def kernel(*signature: Any, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function without Python objects and interpreter lock, cached on disk.

    Without fast-math the same inputs give the same bits in every pacing back end. Division follows
    IEEE 754 (``error_model="numpy"``): a kernel never raises.
    """
    settings = SETTINGS | options
    is_kept = settings.pop("cache", True)
    signatures = (
        signature[0] if signature and isinstance(signature[0], list) else signature
    )

    def decorate(function: Callable[..., Any]) -> Any:
        if stored is None:
            with _numbas_own_cache():
                return numba.njit(*signature, cache=is_kept, **settings)(function)
        return stored.kernel(
            function, signatures, settings, _kept(function) if is_kept else None
        )

    return decorate


def part(function: Callable[..., Any]) -> Any:
    """Compile a unit of the paced step: once by itself, whichever configurations call it.

    It allocates nothing, so numba's reference counting is off: it would cost a third of a tick.
    """
    if stored is None:
        return kernel(_nrt=False)(function)
    return stored.part(
        function, SETTINGS | {"_nrt": False}, lambda name: _kept(function, name)
    )


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
        if stored is None:
            with _numbas_own_cache():
                return numba.cfunc(signature, nopython=True, cache=True)(function)
        return stored.c_function(function, signature, _kept(function))

    return decorate


def _kept(function: Callable[..., Any], variant: str = "") -> Any:
    stamp = source_stamp(Path(function.__code__.co_filename)) + variant
    return stored.Stored(function, shelf(), supplied(), stamp)


@contextlib.contextmanager
def _numbas_own_cache() -> Iterator[None]:
    """Let functions decorated in the block be kept by numba, in a folder of all these sources."""
    before = config.CACHE_DIR
    everything = hash_of(sorted(_PACKAGE.rglob("*.py")))
    config.CACHE_DIR = str(cache_folder(f"{KERNELS}{kernel_hash()}") / everything)
    try:
        yield
    finally:
        config.CACHE_DIR = before
