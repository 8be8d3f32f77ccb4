"""How the kernels are compiled: no interpreter lock, cached by the text of all sources."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import config


def _cache_dir() -> Path:
    """Return a folder whose name changes with any source: numba does not look at callees."""
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    base = os.environ.get("HILSERVER_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    folder = Path(base) if base else Path.home() / ".cache"
    return folder / "hilserver" / f"injector-{digest.hexdigest()[:16]}"


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function for numbers and arrays only."""
    before = config.CACHE_DIR
    config.CACHE_DIR = str(_cache_dir())
    try:
        compiled: Callable[..., Any] = numba.njit(
            nogil=True, cache=True, error_model="numpy"
        )(function)
    finally:
        config.CACHE_DIR = before
    return compiled
