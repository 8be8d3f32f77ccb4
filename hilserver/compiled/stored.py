"""Compiled functions in our own cache, by the text they are made from and not by its place.

numba's cache has the absolute path of the source in its key, executes a damaged file, and has one
folder for the whole process, a user's own functions included. Here a function's cache is its own.
What this uses of numba has no public name; `cache.kernel` falls back to numba's own cache where a
version has moved it.
"""

import hashlib
import pickle
import re
import sys
from collections.abc import Callable
from typing import Any, Final

import numba

# how the step is passed; numba would load it at a call
import numba.experimental.function_type
from numba.core import sigutils, typeinfer
from numba.core.caching import CompileResultCacheImpl, _Cache
from numba.core.ccallback import CFunc
from numba.core.compiler import Compiler, CompileResult
from numba.core.compiler_machinery import PassManager
from numba.core.dispatcher import Dispatcher
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from hilserver.cache import Shelf
from hilserver.compiled import sharing
from hilserver.compiled.supplied import ANY_PROCESSOR, Supplied

WAIT_S: Final = 300.0
"""Longest wait for another process that compiles the same function."""

on_miss: list[Callable[[], None]] = []
"""Each is called once, at the next function that is not in the cache."""

_ADDRESS: Final = re.compile(r"0x[0-9a-f]+")

for _owner, _names in (
    (_Cache, ("load_overload", "save_overload")),
    (Dispatcher, ("add_overload", "compile", "disable_compile", "enable_caching")),
    (CompileResult, ("_reduce", "_rebuild")),
    (CompileResultCacheImpl, ("check_cachable",)),
    (CFunc, ("compile", "enable_caching")),
    (typeinfer, ("register_dispatcher",)),
):
    for _name in _names:
        # AttributeError: this version of numba is not the one we know
        getattr(_owner, _name)


class Pipeline(Compiler):  # type: ignore[misc]
    """The compiler of our kernels; what it makes is what numba's own makes."""

    def define_pipelines(self) -> list[PassManager]:
        """Return numba's passes, one of which is ours."""
        # What is in the cache needs nothing of it.
        from hilserver.compiled.inlining import ours  # noqa: PLC0415

        return [ours(passes) for passes in super().define_pipelines()]


class Stored(_Cache):  # type: ignore[misc]
    """The cache of one function.

    Parameters
    ----------
    stamp : str
        Changes with every source that the compiled code depends on.
    """

    def __init__(
        self, function: Callable[..., Any], shelf: Shelf, supplied: Supplied, stamp: str
    ) -> None:
        self._shelf, self._supplied = shelf, supplied
        code, cells = function.__code__, function.__closure__ or ()
        self._made_from = (
            f"{function.__module__}.{function.__qualname__}:{code.co_firstlineno}",
            stamp,
            sys.implementation.cache_tag,
            hashlib.sha256(code.co_code).hexdigest(),
            hashlib.sha256(dumps([cell.cell_contents for cell in cells])).hexdigest(),
        )
        self._readable = f"{function.__module__.rpartition('.')[2]}.{function.__name__}"
        # What must not be kept is known to numba alone; this needs the names of its messages only.
        self._asks = object.__new__(CompileResultCacheImpl)
        self._asks._locator = _Place(code.co_filename)
        self._asks._lineno = code.co_firstlineno

    @property
    def cache_path(self) -> str:
        """The folder."""
        return str(self._shelf.folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled function for a signature; None: compile it, then save it."""
        # Compiled code needs numba's memory management, but not its implementations of types and
        # functions. Those take a quarter of a second to load, and a compilation loads them itself.
        rtsys.initialize(target_context)
        triple, *processor = target_context.codegen().magic_tuple()
        key = (sig, (triple, *processor), self._made_from)
        name = self._name(key)
        found = self._load(self._shelf.get(name), key, target_context)
        if found is None and self._supplied.is_there:
            for made_for in (processor, ANY_PROCESSOR):
                other = (sig, (triple, *made_for), self._made_from)
                found = self._load(
                    self._supplied.get(self._name(other)), other, target_context
                )
                if found is not None:
                    return found
        if found is None:
            self._supplied.tell_why_absent()
            while on_miss:
                on_miss.pop()()
            self._shelf.wait_for(name, WAIT_S)
            found = self._load(self._shelf.get(name), key, target_context)
            if found is not None:
                self._shelf.let_go(name)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function."""
        key = (sig, data.codegen.magic_tuple(), self._made_from)
        name = self._name(key)
        if self._asks.check_cachable(data):
            self._shelf.put(name, dumps((key, data._reduce())))
        self._shelf.let_go(name)

    def enable(self) -> None:
        """Nothing to do: it is always enabled."""

    def disable(self) -> None:
        """Not supported."""

    def flush(self) -> None:
        """Nothing to do: what is written is on disk."""

    def _name(self, key: Any) -> str:
        # Without addresses, which differ between processes; the key in the file decides.
        text = _ADDRESS.sub("", repr(key))
        return f"{self._readable}-{hashlib.sha256(text.encode()).hexdigest()[:16]}.nbc"

    def _load(self, data: bytes | None, key: Any, target_context: Any) -> Any:
        if data is None:
            return None
        try:
            kept, reduced = pickle.loads(data)  # noqa: S301 - our own file, or one that the sources came with
            if kept != key:
                return None
            return CompileResult._rebuild(target_context, *reduced)
        except Exception:  # noqa: BLE001 - names another version's classes, perhaps; compile anew
            return None


class _Place:
    """The part of numba's locator that its warnings need."""

    def __init__(self, py_file: str) -> None:
        self._py_file = py_file


def kernel(
    function: Callable[..., Any],
    signatures: Any,
    settings: dict[str, Any],
    cache: Stored | None,
) -> Any:
    """Do what `numba.njit` does, with a cache of ours; what is being shared is compiled later."""
    compiled: Any = numba.njit(pipeline_class=Pipeline, **settings)(function)
    if compiled is function:  # NUMBA_DISABLE_JIT
        return compiled
    if cache is not None:
        compiled._cache = cache

    def settle() -> None:
        for name in ("get_call_template", "_compile_for_args"):
            vars(compiled).pop(name, None)
        # It is known by its name only when its decorator has returned, and may call itself.
        with typeinfer.register_dispatcher(compiled):
            for signature in signatures:
                compiled.compile(signature)
            compiled.disable_compile()

    share = sharing.current()
    if signatures and share is not None:
        # Its first caller must find the signatures that it has, and make no other.
        def typed(*args: Any, **named: Any) -> Any:
            share.take(settle)
            return compiled.get_call_template(*args, **named)

        def called(*_: Any, **__: Any) -> Any:
            share.take(settle)
            return compiled

        compiled.get_call_template, compiled._compile_for_args = typed, called
        share.put_off(f"{function.__module__}.{function.__qualname__}", settle)
    elif signatures:
        settle()
    return compiled


def part(
    function: Callable[..., Any],
    settings: dict[str, Any],
    kept: Callable[[str], Stored],
) -> Any:
    """Compile a function for its callers among the kernels, without an entry for Python and for C.

    The entries would be a sixth of a cold start. Where Python calls it, as tests do, it is compiled
    once more, with them.

    Parameters
    ----------
    kept : callable
        Returns the cache of one of the two by a name.
    """
    without = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled = kernel(function, (), settings | without, kept("inside"))
    if compiled is function:  # NUMBA_DISABLE_JIT
        return compiled
    with_entry: list[Any] = []

    def for_python(*_: Any, **__: Any) -> Any:
        if not with_entry:
            with_entry.append(kernel(function, (), settings, kept("")))
        return with_entry[0]

    def known_to_kernels(result: CompileResult) -> None:
        compiled.overloads[tuple(result.signature.args)] = result

    compiled._compile_for_args = for_python
    # numba's own would let Python call what has no entry
    compiled.add_overload = known_to_kernels
    return compiled


def c_function(function: Callable[..., Any], signature: Any, cache: Stored) -> Any:
    """Do what `numba.cfunc` does, with a cache of ours."""
    callback: Any = CFunc(
        function,
        sigutils.normalize_signature(signature),
        locals={},
        options={"nopython": True},
    )
    callback._cache = cache
    callback.compile()
    return callback
