"""numba's compiler, which copies a helper no longer when it puts it into its caller.

numba reads a helper anew at each of its places, copies what it has read twice, each block with all
variables of the function, and throws the second copy away. That was a sixth of a cold start.
"""

import inspect
from collections.abc import Callable
from typing import Any, Final

from numba.core import ir
from numba.core.compiler import DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.inline_closurecall import InlineWorker
from numba.core.untyped_passes import InlineInlinables


def _takes(method: Callable[..., Any], *names: str) -> bool:
    return set(names) <= set(inspect.signature(method).parameters)


IS_KNOWN: Final = _takes(
    InlineWorker.inline_ir, "caller_ir", "block", "i", "callee_ir"
) and _takes(InlineInlinables._do_work, "inline_worker")
"""Whether numba is made as it was here; if not, its own way is taken."""


class _Fresh(ir.Block):  # type: ignore[misc]
    """A block of a function that was read for one place: nobody else has it."""

    def __deepcopy__(self, memo: dict[int, Any]) -> "_Fresh":
        return self


class _Worker(InlineWorker):  # type: ignore[misc]
    """Puts one function into another."""

    def inline_ir(
        self, caller: Any, block: Any, i: int, callee: Any, *rest: Any, **named: Any
    ) -> Any:
        """Put `callee`, which nobody else has, at statement `i` of a block of `caller`."""
        for own in callee.blocks.values():
            own.__class__ = _Fresh
        done = super().inline_ir(caller, block, i, callee, *rest, **named)
        for _, new in done[-1]:
            new.__class__ = ir.Block
        return done


@register_pass(mutates_CFG=True, analysis_only=False)
class _Inlining(InlineInlinables):  # type: ignore[misc]
    _name = "hilserver_inlining"

    def _do_work(self, *words: Any) -> Any:
        worker = words[-1]
        worker.__class__ = _Worker
        worker._compiler_pipeline = _untyped
        return super()._do_work(*words)


def _untyped(state: Any) -> PassManager:
    return ours(DefaultPassBuilder.define_untyped_pipeline(state))


def ours(passes: PassManager) -> PassManager:
    """Return numba's passes with our way of putting helpers into their callers."""
    if not IS_KNOWN:
        return passes
    passes.passes = [
        (_Inlining if kind is InlineInlinables else kind, said)
        for kind, said in passes.passes
    ]
    return passes
