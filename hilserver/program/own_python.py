"""A user's own Python function or class, by ``file.py:name`` or ``package.module:name``."""

import importlib
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from hilserver.errors import ConfigError

_HERE = Path(__file__).resolve().parents[1]


def load_callable(reference: str, folder: Path) -> Callable[..., Any]:
    """Import what a reference names, a file relative to `folder`; ConfigError if that fails."""
    place, colon, name = reference.rpartition(":")
    if not colon or not place or not name:
        raise ConfigError(f"{reference!r}: write file.py:name or package.module:name")
    try:
        module = _module(place, folder)
    except ConfigError:
        raise
    except (Exception, SystemExit) as error:
        raise ConfigError(
            f"{reference!r}: the import failed: {described(error)}"
        ) from error
    found = getattr(module, name, None)
    if not callable(found):
        what = "there is no" if found is None else "not a function or class:"
        raise ConfigError(f"{reference!r}: {what} '{name}' in {place}")
    return found  # type: ignore[no-any-return]


def _module(place: str, folder: Path) -> ModuleType:
    if not place.endswith(".py"):
        return importlib.import_module(place)
    path = (folder / place).resolve()
    if not path.is_file():
        raise ConfigError(f"there is no file {path}")
    name = f"hilserver_own_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def described(error: BaseException, most: int = 300) -> str:
    """Return an exception of a user's code in one line: type, text, and source line."""
    where = ""
    trace = error.__traceback__
    while trace is not None:
        file = Path(trace.tb_frame.f_code.co_filename)
        if _HERE not in file.parents:
            where = f" ({file.name}:{trace.tb_lineno})"
        trace = trace.tb_next
    text = " ".join(str(error).split())[:most]
    if text:
        return f"{type(error).__name__}: {text}{where}"
    return f"{type(error).__name__}{where}"
